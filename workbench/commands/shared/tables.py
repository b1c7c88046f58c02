"""Terminal output of the robot commands; each function reads only the JSON answer."""

from collections.abc import Mapping, Sequence

from workbench.core.text.confounded import confounded_lists
from workbench.core.text.stiffness_text import holds_for, stiffness_table

MEASURES = ("rms_mm", "mean_mm", "p95_mm", "max_mm")
ROTATION_MEASURES = (
    "rotation_rms_deg",
    "rotation_mean_deg",
    "rotation_p95_deg",
    "rotation_max_deg",
)
_LONGEST_NAME = 40
_MOST_TERMS = 12
_MOST_SENTENCES = 10
_GAP = 2  # spaces between columns
_BLOCKS = ("nominal", "fit", "held_out")
_DEGREES = ("rotation_rms_deg", "held_out_rotation_rms_deg")


def calibration(console, answer: Mapping) -> None:
    """Headline, stages and the largest corrections of a calibration.

    answer: the object of `calibrate --json`.
    """
    warnings(console, answer)
    _errors(console, answer)
    _stages(console, answer["stages"])
    from robot_model.effects.curve import JointCurve
    from robot_model.tool_points import undetermined_points_remark

    curves = answer.get("joint_curves", [])
    _joint_curves(console, curves)
    is_misfit = answer.get("noise", {}).get("level", "none") != "none"
    _stiffness(console, answer.get("stiffness", []), is_misfit)
    _terms(console, answer.get("terms", []))
    described = tuple(f"{row['where']}.{JointCurve.effect}." for row in curves)
    others = [p for p in answer["parameters"] if not _key(p).startswith(described)]
    _parameters(console, others)
    if sentence := unidentified(answer["parameters"]):
        console.print(f"{sentence}\n", markup=False)
    if sentence := combinations(answer["stages"]):
        console.print(f"{sentence}\n", markup=False)
    values = {_key(row): row["value"] for row in answer["parameters"]}
    if sentence := undetermined_points_remark(values):
        console.print(f"{sentence}\n", markup=False)


def combinations(stages: Sequence[Mapping]) -> str:
    """Number of identifiable parameter combinations of the first stage, in words; "" if all are identifiable."""
    if not stages or stages[0]["identifiable"] >= stages[0]["free"]:
        return ""
    stage = stages[0]
    return (
        f"{stage['identifiable']} of {stage['free']} combinations of the {stage['name']} are identifiable. The others "
        "have conventional values, which do not affect predictions and corrections of the measured points."
    )


def warnings(console, answer: Mapping) -> None:
    """Print warnings in red; findings on the noise, which are common on real arms, as notes."""
    noise = answer.get("noise") or {}
    for warning in answer.get("warnings", ()):
        if warning in noise.get("findings", ()):
            console.print(f"Note: {warning}", style="yellow", markup=False)
        else:
            console.print(f"Warning: {warning}", style="bold red", markup=False)


def identifiability(console, answer: Mapping) -> None:
    """Print which parameters the recording identifies, and which not.

    answer: the object of `identifiability --json`.
    """
    head = ["stage", "free", "identified", "O1", "O2", "O3", "O4", "O5"]
    rows = [
        [s["name"], s["free"], s["identifiable"], *(number(s[f"O{k}"], 3) for k in range(1, 6))]
        for s in answer["stages"]
    ]
    grid(
        console,
        f"{answer['recording']}: {answer['samples']} samples at {answer['poses']} poses",
        head,
        rows,
    )
    for title, sentences in confounded_lists(answer["stages"]):
        hidden_count = max(len(sentences) - _MOST_SENTENCES, 0)
        remark = [f"{hidden_count} more, on the report page"] if hidden_count else []
        _listing(console, f"Not identifiable {title}", [*sentences[:_MOST_SENTENCES], *remark])


def number(value, digits: int = 4) -> str:
    """`value` with `digits` significant digits; a dash for None."""
    return (
        "–" if value is None else f"{value:.{digits}g}" if isinstance(value, float) else str(value)
    )


def measured(value: float | None, std: float | None) -> tuple[str, str]:
    """A value and its standard deviation, rounded to two digits of the latter; four digits without one."""
    from math import floor, isfinite, log10

    if value is None or not std or not isfinite(std):
        return number(value), "–"
    places = max(0, 1 - floor(log10(std)))
    spread = f"{std:.2g}" if std < 100 else f"{std:.0f}"
    return (f"{value:.{places}f}", spread) if places < 8 else (number(value), spread)


def grid(console, title: str, head: Sequence[str], rows: Sequence[Sequence], left: int = 1) -> None:
    """Print a table. The first `left` columns, and any without a heading, are text; the others are numbers.

    Numbers and the names of the first column are never wrapped, and no word is broken. A table that is too wide for the
    terminal gets headings of several lines, then wrapped text, and else keeps its width.
    """
    from rich import box
    from rich.markup import escape
    from rich.table import Table
    from rich.text import Text

    if title:
        console.print(title, style="bold", markup=False)
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    texts = [index < left or not name for index, name in enumerate(head)]
    widths = _column_widths(head, rows, texts, console.width)
    for name, word, width in zip(head, texts, widths):
        table.add_column(
            name, justify="left" if word else "right", overflow="fold", min_width=width, width=width
        )
    for row in rows:
        table.add_row(*(escape(number(cell)) for cell in row))
    wide = console.options.update(width=max(sum(widths) + _GAP * (len(widths) - 1), console.width))
    for line in console.render_lines(
        table, wide, pad=False
    ):  # print() has no more than the terminal's width
        text = Text.assemble(*((part.text, part.style or "") for part in line))
        text.rstrip()
        console.print(text, soft_wrap=True)
    console.print()


def _column_widths(
    head, rows: Sequence[Sequence], texts: Sequence[bool], max_width: int
) -> list[int]:
    """Characters of each column of a table that has `max_width`, or more where no word can be wrapped any more.

    texts: which columns are text. The others are wide enough for their longest cell, and for each word of the heading.
    """
    full = [max(len(name), _longest(rows, index), 1) for index, name in enumerate(head)]
    if sum(full) + _GAP * (len(full) - 1) <= max_width:
        return full
    min_widths = [_least_width(head[k], rows, k, texts[k]) for k in range(len(head))]
    spare = max(max_width - sum(min_widths) - _GAP * (len(min_widths) - 1), 0)
    needed_widths = [wide - narrow for wide, narrow in zip(full, min_widths)]
    for k in sorted(range(len(head)), key=lambda k: (not texts[k], needed_widths[k])):
        given = min(needed_widths[k], spare)
        min_widths[k] += given
        spare -= given
    return min_widths


def _least_width(name: str, rows: Sequence[Sequence], index: int, is_text: bool) -> int:
    """Characters of the longest word of a column, or of its longest cell if cells stay whole."""
    is_whole = not is_text or (index == 0 and _longest(rows, index) <= _LONGEST_NAME)
    cells = [number(row[index]) for row in rows]
    words = cells if is_whole else [word for cell in cells for word in cell.split()]
    longest = max(map(len, [*words, *name.split()]), default=1)
    return max(longest if is_whole else min(longest, _LONGEST_NAME), 1)


def _longest(rows: Sequence[Sequence], index: int) -> int:
    """Characters of the longest cell of a column."""
    return max((len(number(row[index])) for row in rows), default=0)


def _errors(console, answer: Mapping) -> None:
    from workbench.fitting.verdicts.calibration_verdict import ONE_NUMBER

    title = f"{answer['recording']}: {answer['samples']} samples, {answer['measures']}"
    position = "residual, mm" if answer["measures"] in ONE_NUMBER else "3-D error, mm"
    for quantity, measures in ((position, MEASURES), ("rotation error, deg", ROTATION_MEASURES)):
        blocks = [name for name in _BLOCKS if measures[0] in answer.get(name, ())]
        if not blocks:
            continue
        rows = [
            [name.replace("_", " "), *(answer[name].get(key) for key in measures)]
            for name in blocks
        ]
        grid(console, title, [quantity, "RMS", "mean", "95 %", "max"], rows)
        title = ""
    held_out = answer.get("held_out", {})
    if "refitted_mm" in held_out:
        console.print(f"Held out are the {held_out['samples']} test samples.")


def _stages(console, stages: Sequence[Mapping]) -> None:
    head = ["stage", "free", "identified", "RMS mm", "held out mm"]
    keys = ["free", "identifiable", "rms_mm", "held_out_rms_mm"]
    if any(_DEGREES[0] in stage for stage in stages):
        head, keys = [*head, "RMS deg", "held out deg"], [*keys, *_DEGREES]
    rows = [[stage["name"], *(stage.get(key) for key in keys), _verdict(stage)] for stage in stages]
    grid(console, "Stages", [*head, ""], rows)


def _verdict(stage: Mapping) -> str:
    earned = stage.get("earned", stage.get("kept"))
    return "" if earned is None or earned else "not retained"


def _stiffness(console, stiffness: Sequence[Mapping], is_misfit: bool) -> None:
    """Stiffness of the joints in N m/rad where loads or masses are known, else deflection under the links."""
    if not stiffness:
        return
    title, head, rows = stiffness_table(stiffness)
    grid(console, title, head, rows, left=3)
    if validity := holds_for(stiffness, is_misfit):
        console.print(f"{validity.replace('`', '')}\n", markup=False)


def _terms(console, terms: Sequence[Mapping]) -> None:
    """The largest terms of the model, by how far each moves the measured point."""
    if not terms:
        return
    rows = [[_term_name(row), f"{row['rms_mm']:.3g}"] for row in terms[:_MOST_TERMS]]
    unlisted_count = len(terms) - len(rows)
    title = "Terms of the model, RMS change of the measured point beyond base and tool"
    title += f" ({unlisted_count} smaller ones are in the JSON)" if unlisted_count else ""
    grid(console, title, ["term", "RMS mm"], rows)


def _term_name(row: Mapping) -> str:
    return f"{row['name']}, order {row['order']}" if "order" in row else row["name"]


def _key(row: Mapping) -> str:
    return f"{row['where']}.{row['name']}"


def _joint_curves(console, curves: Sequence[Mapping]) -> None:
    """Size and dominant cycles of the error of each joint that has an error curve."""
    if not curves:
        return
    rows = []
    for curve in curves:
        factor, unit = (1e3, "mrad") if curve["unit"] == "rad" else (1.0, "mm")
        cycles = [_cycle(cycle, factor) for cycle in curve["cycles"]]
        rows.append([curve["where"], f"{curve['rms'] * factor:.3f} {unit}", ", ".join(cycles)])
    title = (
        "Error of joints as a function of their angle (error curve and harmonics together): "
        "cycles per revolution (amplitude), the largest of each"
    )
    grid(console, title, ["where", "RMS", "dominant cycles"], rows)


def _cycle(cycle: Mapping, factor: float) -> str:
    """'17 (0.21)', and how many cycles that is per revolution of the motor where they agree."""
    motor = cycle.get("per_motor_revolution")
    tied = f", {motor} per motor revolution" if motor else ""
    return f"{cycle['order']:.3g} ({cycle['amplitude'] * factor:.2g}{tied})"


def _parameters(console, parameters: Sequence[Mapping], max_rows: int = 15) -> None:
    """Print the most significant and the largest deviations from nominal; the result files hold all."""
    estimated = [row for row in parameters if row["identifiable"] and row["deviation"] is not None]
    ranked = sorted(estimated, key=_significance, reverse=True)[:max_rows]
    large = [row for row in _largest_lengths(parameters) if row not in ranked]
    significant = f"the {len(ranked)} most significant of {len(estimated)}" if ranked else ""
    chosen = [significant, "the largest in mm" if large else ""]
    title = f"Deviations from nominal, {' and '.join(filter(None, chosen))}"
    head = ["where", "name", "unit", "value", "deviation", "std"]
    if ranked or large:
        grid(console, title, head, [_parameter(row) for row in (*ranked, *large)], left=3)
    for row in large:
        if row.get("tied_to"):
            others = ", ".join(row["tied_to"])
            line = f"{row['where']}.{row['name']} is identifiable only together with {others}."
            console.print(line, markup=False)


def _largest_lengths(parameters: Sequence[Mapping], max_rows: int = 3) -> list[Mapping]:
    """Lengths of the arm with the largest deviations, estimated or only in combination with others."""
    lengths = [
        row
        for row in parameters
        if row["unit"] == "mm" and row["where"].startswith("joint-") and row.get("free", True)
    ]
    moved = [row for row in lengths if row["deviation"]]
    return sorted(moved, key=lambda row: abs(row["deviation"]), reverse=True)[:max_rows]


def _parameter(row: Mapping) -> list:
    """Cells of one parameter: angles in degrees, numbers rounded to two digits of their standard deviation."""
    from workbench.report.text import shown_unit  # `--help` must not wait for the reports

    unit, factor = shown_unit(row["unit"])
    if row["std"] is None:
        value, deviation = factor * row["value"], factor * row["deviation"]
        return [row["where"], row["name"], unit, f"{value:.4f}", f"{deviation:+.4f}", "–"]
    std = factor * row["std"]
    value, spread = measured(factor * row["value"], std)
    deviation, _ = measured(factor * row["deviation"], std)
    signed = deviation if deviation.startswith("-") else f"+{deviation}"
    return [row["where"], row["name"], unit, value, signed, spread]


def unidentified(parameters: Sequence[Mapping]) -> str:
    """Numbers of estimated and of unidentifiable parameters, in words; "" if all are estimated."""
    missing = [row for row in parameters if not row["identifiable"]]
    if not missing:
        return ""
    held_count = sum(row["status"] == "held" for row in missing)
    at_zero = sum(row["status"] == "at zero" for row in missing)
    estimated = len(parameters) - len(missing)
    bounded = (
        f"{at_zero} cannot be negative, {'was' if at_zero == 1 else 'were'} estimated below zero and "
        f"{'is' if at_zero == 1 else 'are'} held at zero. "
        if at_zero
        else ""
    )
    return (
        f"{estimated} of {len(parameters)} parameters are estimated. {len(missing) - held_count - at_zero} are not "
        "identifiable: in these poses they are confounded with others or have no effect. "
        f"{bounded}{held_count} are held fixed by the plan. The report page states the reasons."
    )


def _significance(row: Mapping) -> float:
    return abs(row["deviation"]) / row["std"] if row["std"] else 0.0


def _listing(console, title: str, values: Sequence) -> None:
    console.print(f"{title}:")
    for value in values:
        console.print(f"  - {value}", markup=False)
