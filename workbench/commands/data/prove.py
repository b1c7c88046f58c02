"""`workbench prove`: blind benchmark of the diagnosis, with a scoreboard."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer

Suites = Annotated[
    list[str] | None,
    typer.Option(
        "--suite", metavar="NAME[=COUNT]", help="Run only this suite, with COUNT cases. Repeatable."
    ),
]


def command(
    suite: Suites = None,
    cases: Annotated[
        int | None,
        typer.Option("--cases", min=1, help="Number of cases of a suite without a count."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the random cases.")] = 1,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", metavar="DIR", help="Folder with your own recordings and truths."),
    ] = None,
    jobs: answer.Jobs = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder of the benchmark run.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(
            "--minutes",
            min=0,
            help="Start no diagnosis after this time; repeat the command to continue.",
        ),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option("--page", metavar="FILE.md", help="Also write the scoreboard as Markdown."),
    ] = None,
    no_report: answer.NoReport = False,
    json: answer.JsonTarget = None,
) -> None:
    """Run the blind benchmark of the diagnosis: simulated recordings with planted effects, scored against their truth.

    The SHA-256 of each truth is published before the diagnosis runs. An interrupted benchmark continues with the
    same command.
    """
    answer.check_target(json)
    with answer.progress("creating cases") as progress:
        from workbench.files import runs
        from workbench.proving import prove

        place = out or prove.default_folder(seed, folder)
        board = prove.prove(place, suite or (), cases, seed, folder, jobs, progress, minutes)
        result = {**board.as_json(), "run": place.resolve()}
        runs.replace_file(place / "answer.json", answer.as_text(result))
        if not no_report:
            progress("writing the scoreboard")
            from workbench.report.scoreboard.html_page import write_scoreboard

            write_scoreboard(board, place)
        if page:
            progress(f"writing {page}")
            from workbench.report.scoreboard.markdown_page import write_page

            write_page(board, place, page)
    answer.deliver(result, json)
    _show(answer.console(json), result)
    answer.last_line(answer.console(json), place.resolve())


def _show(console, result) -> None:
    """Print one line per figure."""
    console.print(f"{result['cases']} blind cases, seed {result['seed']}", style="bold")
    for f in result["figures"]:
        cases = f"{f['hits']} of {f['cases']}" if f["hits"] is not None else f["cases"]
        word = _WORDS.get(f["word"], f["word"])
        line = f"{word:14}{_value(f):>7}  {cases:>11}  {_interval(f):17}{f['asked']:23}{f['suite']}: {f['name']}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    for suite, why in result["skipped"].items():
        console.print(f"suite {suite} was skipped: {why}", markup=False)


_WORDS = {"reached": "met", "short": "not met"}


def _value(figure) -> str:
    if figure["value"] is None:
        return "–"
    share = figure["hits"] is not None or "limit" in figure["name"]
    return f"{figure['value']:.1%}" if share else f"{figure['value']:.2f}"


def _interval(figure) -> str:
    if figure["low"] is None or not figure["cases"]:
        return ""
    form = ".2f" if figure["hits"] is None else ".1%"
    return f"{figure['low']:{form}} – {figure['high']:{form}}"
