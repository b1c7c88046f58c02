"""Page of a study: outcome over the varied parameters, sensitivity, and a table of all figures."""

from workbench.report.sections import Page, Section, facts, figure, note, pair, table, words
from workbench.report.study import figures as figures
from workbench.report.study import maps as maps
from workbench.report.text import axis_label, column_label, counted, rounded, sentence
from workbench.studies import tables
from workbench.studies.summary import numeric

_MOST_FIGURES = 6
_ROWS = 120


def page(study_run, found: dict) -> Page:
    """The page of a finished study; found: the result of `summary`."""
    outcome = next((row for row in found["columns"] if row["column"] == found["outcome"]), None)
    numbers = [("runs", f"{found['runs']:,}", "")]
    if outcome is not None:
        unit = outcome["column"].rpartition("_")[2]
        unit = unit if unit in ("mm", "px", "deg") else ""
        label = column_label(outcome["column"]).removesuffix(f" ({unit})")
        numbers += [
            (f"{label}, median", rounded(outcome["median"]), unit),
            ("95 % of the runs are below", rounded(outcome["p95"]), unit),
        ]
    lead = [_lead(study_run, found), *found["sentences"]]
    return Page(
        "Study",
        found["title"],
        tuple(numbers),
        tuple(lead),
        tuple(_sections(study_run, found)),
        files=(tables.TABLE, tables.CSV),
    )


def _lead(study_run, found) -> str:
    subject = " and ".join(found["do"]) + (
        "" if study_run.study.scene else f" of {study_run.study.recording}"
    )
    count = len(found["varied"])
    if count:
        varied = f", with {counted(count, 'parameter')} varied ({study_run.study.vary.method})"
    else:
        varied = ""
    article = "an" if found["kind"][0] in "aeiou" else "a"
    return f"{counted(found['done'], 'run')} of {article} {found['kind']} study: {subject}{varied}."


def _sections(study_run, found):
    yield Section("outcome", "Outcome", tuple(_outcome(study_run, found)))
    blocks_of = {
        "compliance": _compliance,
        "sensor": _sensor,
        "uncertainty": _uncertainty,
        "design": _design,
    }[found["kind"]]
    blocks = tuple(blocks_of(study_run, found))
    if blocks:
        yield Section(found["kind"], _TITLES[found["kind"]], blocks)
    if "indices" in found["sensitivity"]:
        yield Section("sensitivity", "Sensitivity", tuple(_sensitivity(found)))
    yield Section("figures", "All figures", tuple(_table(found)))
    yield Section("made", "Seed, work and parameters", tuple(_made(study_run, found)))


_TITLES = {
    "compliance": "Compliance error",
    "sensor": "Form and incidence",
    "uncertainty": "Coverage of the stated standard deviations",
    "design": "Outcome by design",
}


def _outcome(study_run, found):
    """The outcome over each parameter, and its distribution."""
    axes = study_run.study.vary.parameter
    name = found["outcome"]
    columns = tables.columns(study_run.path, [name, *(axis.name for axis in axes)])
    values = columns[name]
    label = column_label(name)
    if found["not_done"]:
        lines = [sentence(f"{row['runs']} runs: {row['why']}") for row in found["not_done"]]
        yield note("Some runs failed", lines)
    drawn = [axis for axis in axes if numeric(axis)][:_MOST_FIGURES]
    groups = next((columns[axis.name] for axis in axes if not numeric(axis)), None)
    shown = [
        figure(
            f"over{k}",
            figures.scatter_of_runs(axis, columns[axis.name], values, name, groups),
            f"{label} over {axis_label(axis)}: one dot per run, line through the medians, band of 90 %.",
        )
        for k, axis in enumerate(drawn)
    ]
    for k in range(0, len(shown), 2):
        yield pair(*shown[k : k + 2]) if len(shown[k : k + 2]) == 2 else shown[k]
    yield figure(
        "spread",
        figures.spread(values, name),
        f"Distribution of {label} over {counted(len(values), 'run')}.",
    )


def _compliance(study_run, found):
    if found["stiffen"]:
        yield figure(
            "stiffen",
            figures.stiffen(found["stiffen"]),
            "Uncalibrated error with one joint twice as stiff, as a share of the present error. Bars are "
            "means over the runs, whiskers cover 90 % of them. The shortest bar is the joint to stiffen.",
        )
    loads = figures.by_load(found["columns"])
    if loads is not None:
        yield figure(
            "loads",
            loads,
            "RMS error at further poses of the workspace, by payload: medians over the "
            "runs and the band that covers 90 % of them.",
        )
    if study_run.study.scene is not None:
        yield from maps.blocks(study_run.study, study_run.path)


def _sensor(study_run, found):
    bands = figures.by_incidence(found["columns"])
    if bands is not None:
        yield figure(
            "incidence",
            bands,
            "RMS distance of points from the sphere, by the angle between surface and line of sight: "
            "medians over the runs and the band that covers 90 % of them.",
        )
    names = [row["column"] for row in found["columns"]]
    if {"centre_rms_mm", "sigma_mm"} <= set(names):
        columns = tables.columns(study_run.path, ["centre_rms_mm", "sigma_mm"])
        yield figure(
            "stated",
            figures.stated(columns["sigma_mm"], columns["centre_rms_mm"]),
            "Error of the centres over their stated standard deviation, one dot per run. About 60 % of the dots "
            "should lie below the line.",
        )


def _uncertainty(study_run, found):
    rows = found["coverage"]
    if not rows:
        return
    known = "within_2" in rows[0]
    caption = (
        "Share of runs whose 95 % interval contains the true value. The band is the 95 % sampling range "
        "around 95 %."
        if known
        else "Standard deviation of the values over resampled poses, divided by the standard deviation that "
        "the calibration of the whole recording states."
    )
    yield figure("coverage", figures.coverage(rows), caption)
    head = [
        "parameter",
        "value",
        "stated σ",
        "spread",
        "spread / σ",
        *(("in 1 σ (%)", "in 1.96 σ (%)") if known else ()),
    ]
    yield table(head, [_covered(row, known) for row in rows])


def _covered(row, known) -> list[str]:
    """A row of the table of coverage."""
    columns = [("whole", 5), ("whole_std", 2), ("spread", 2), ("ratio", 2)]
    if known:
        shares = [rounded(100 * row[key]) for key in ("within_1", "within_2")]
    else:
        shares = []
    return [row["parameter"], *(rounded(row[key], digits) for key, digits in columns), *shares]


def _design(study_run, found):
    axes = [axis for axis in study_run.study.vary.parameter if numeric(axis)]
    if len(axes) == 2 and study_run.study.vary.method == "grid":
        columns = tables.columns(study_run.path, [*(axis.name for axis in axes), found["outcome"]])
        yield figure(
            "map",
            figures.grid_map(axes, columns, found["outcome"]),
            f"Median {column_label(found['outcome'])} over the repeats of each point of the grid.",
        )


def _sensitivity(found):
    study_run = found["sensitivity"]
    yield words(
        f"Share of the variance of {column_label(study_run['outcome'])} due to each parameter "
        f"({study_run['method']}, SALib). "
        "First: the parameter alone. Total: including interactions with other parameters."
    )
    yield figure("indices", figures.indices(study_run["indices"]), "Whiskers are 95 % intervals.")


def _table(found):
    head = ["quantity", "runs", "mean", "std", "5 %", "median", "95 %", "max"]
    keys = ["mean", "std", "p5", "median", "p95", "max"]
    shown = [row for row in found["columns"] if ":" not in row["column"]][:_ROWS]
    rows = [
        [column_label(row["column"]), f"{row['n']:,}", *(rounded(row[key]) for key in keys)]
        for row in shown
    ]
    yield table(head, rows)
    if len(found["columns"]) > len(shown):
        yield words(
            f"answer.json holds the other {len(found['columns']) - len(shown)} columns, such as each parameter.",
            quiet=True,
        )


def _made(study_run, found):
    study = study_run.study
    work = found["work"]
    took = f"{work['seconds_of_runs']:.1f} s of runs in {work['seconds']:.1f} s"
    duration = f"{took} on {counted(work['workers'], 'worker')}"
    axes = [
        (axis.name, f"{', '.join(axis.paths)}: {_range(axis)}") for axis in study.vary.parameter
    ]
    yield facts(
        [
            ("Seed", study.seed),
            ("Computed now", f"{work['runs_made_now']:,} runs, {duration}"),
            (
                "Overhead",
                ""
                if work["overhead"] is None
                else f"{100 * work['overhead']:.1f} % on top of the runs, including the start of the workers",
            ),
            ("Repeat a run", f"workbench study {study_run.name} --run NUMBER"),
            *axes,
        ]
    )


def _range(axis) -> str:
    """Range or values of a varied parameter."""
    if axis.values is None:
        return f"{axis.low:g} to {axis.high:g}, {axis.scale}"
    return ", ".join(map(str, axis.values))
