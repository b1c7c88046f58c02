"""`workbench register`: points of an arm against points of a tracker, by a rigid transform."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, tables
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts.verdict import no_verdict

Nearest = Annotated[
    bool,
    typer.Option(
        "--nearest", help="Match every point with the nearest one (ICP) instead of by name or row."
    ),
]
Unit = Annotated[
    str | None,
    typer.Option("--unit", help="Unit of coordinates that state none: mm, m, in or cm."),
]
_NO_RESIDUAL = "The agreement of two sets of points is stated; the noise of neither is known."


def command(
    source: Annotated[
        Path,
        typer.Argument(
            help="Points to transform (CSV): x_mm, y_mm, z_mm, and their names in `point`."
        ),
    ],
    target: Annotated[
        Path, typer.Argument(help="Points of the tracker (CSV), in the same columns.")
    ],
    nearest: Nearest = False,
    unit: Unit = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
) -> None:
    """Register measured points to those of a tracker: rigid transform, and distance of each point.

    The rigid transform is the least-squares one. Points correspond by the column `point`, by row where there is none,
    or by nearness with --nearest. The error of every point is also stated with that point left out of the fit.
    """
    answer.check_target(json)
    runs.check_place(out)
    with answer.progress(f"reading {source}"):
        from datasets.importers.units import LENGTHS
        from workbench.files.points import read_points
        from workbench.jobs.robot.register import register, save, suspicions

        if unit is not None and unit not in LENGTHS:
            raise InputError(
                f"--unit: expected one of {', '.join(LENGTHS)}, found {unit}; correct it."
            )
        names, points = read_points(source, unit)
        other_names, others = read_points(target, unit)
        rows = _corresponding(names, other_names, source, target) if not nearest else None
        others = others if rows is None else others[rows[1]]
        points = points if rows is None else points[rows[0]]
        found = register(points, others, matched=not nearest)
        labels = _labels(names, rows, len(points))
        with runs.opened("register", source.stem, out) as run:
            save(found, labels, run.partial)
            result = {
                "command": "register",
                "source": source,
                "target": target,
                **found.as_json(),
                "max_point": labels[int(found.distances.argmax())],
                "outliers": [labels[k] for k in found.outliers()],
                "warnings": list(suspicions(points, others, found, not nearest)),
                "verdict": no_verdict(_NO_RESIDUAL).as_json(),
                "run": run.path,
            }
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
            if not no_report:
                from workbench.report.page import write_sheet
                from workbench.report.planning import registration

                write_sheet(registration.page(found, points, labels, result), run.partial)
    answer.deliver(result, json)
    _show(answer.console(json), result)


def _corresponding(names, others, source: Path, target: Path) -> tuple[list[int], list[int]] | None:
    """Rows of source and target with the same name; None where a file has no names and rows correspond."""
    if names is None or others is None:
        return None
    for name in names:
        if name not in others:
            raise InputError(
                f"{source}, column point: expected points that {target} has, too, found {name}; rename or remove it"
            )
    return list(range(len(names))), list(map(others.index, names))


def _labels(names, rows, count: int) -> list[str]:
    if names is None:
        return [str(k) for k in range(1, count + 1)]
    return names if rows is None else [names[k] for k in rows[0]]


def _show(console, result) -> None:
    names = {
        "rms_mm": "RMS distance",
        "mean_mm": "mean distance",
        "std_mm": "standard deviation of the distance",
        "max_mm": f"largest distance (point {result['max_point']})",
        "sigma_mm": "standard deviation of a coordinate",
        "left_one_out_rms_mm": "leave-one-out RMS distance",
    }
    rows = [[text, result[key]] for key, text in names.items() if result[key] is not None]
    tables.grid(console, f"{result['points']} points", ["", "mm"], rows)
    for sentence in result["warnings"]:
        console.print(f"Warning: {sentence}", style="bold red", markup=False, soft_wrap=True)
    if result["outliers"]:
        console.print(
            f"Warning: {', '.join(result['outliers'])}: much farther off than the other points, whose agreement is "
            "therefore better than these figures; measure again, or remove it from both files.",
            style="bold red",
            markup=False,
        )
    console.print(str(result["run"]), soft_wrap=True, markup=False)
