"""`workbench prove`: the diagnosis on data in which the effect is concealed, and the scoreboard of it."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer

Suites = Annotated[
    list[str] | None,
    typer.Option(
        "--suite", metavar="NAME[=COUNT]", help="Only this suite, so many of it; once for each."
    ),
]


def command(
    suite: Suites = None,
    cases: Annotated[
        int | None, typer.Option("--cases", min=1, help="Cases of a suite without a count.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Other seeds are other cases.")] = 1,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", metavar="DIR", help="Recordings and sealed answers of your own."),
    ] = None,
    jobs: answer.Jobs = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The folder of the examination.")
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option("--minutes", min=0, help="Begin no diagnosis later; call again to go on."),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option("--page", metavar="FILE.md", help="Write the scoreboard as Markdown, too."),
    ] = None,
    no_report: answer.NoReport = False,
    json: answer.JsonTarget = None,
) -> None:
    """Conceal effects, seal them, diagnose, open and score; an interrupted examination goes on where it was."""
    answer.check_target(json)
    with answer.progress("concealing") as say:
        from workbench.files import runs
        from workbench.proving import prove

        place = out or prove.default_folder(seed, folder)
        board = prove.prove(place, suite or (), cases, seed, folder, jobs, say, minutes)
        result = {**board.as_json(), "run": place.resolve()}
        runs.replace_file(place / "answer.json", answer.as_text(result))
        if not no_report:
            say("writing the scoreboard")
            from workbench.report.scoreboard.html_page import write_scoreboard

            write_scoreboard(board, place)
        if page:
            say(f"writing {page}")
            from workbench.report.scoreboard.markdown_page import write_page

            write_page(board, place, page)
    answer.deliver(result, json)
    _show(answer.console(json), result)
    answer.last_line(answer.console(json), place.resolve())


def _show(console, result) -> None:
    """A line a figure: they are many, and their names are long."""
    console.print(f"{result['cases']} concealed cases, seed {result['seed']}", style="bold")
    for f in result["figures"]:
        cases = f"{f['hits']} of {f['cases']}" if f["hits"] is not None else f["cases"]
        line = f"{f['word']:14}{_value(f):>7}  {cases:>11}  {_interval(f):17}{f['asked']:23}{f['suite']}: {f['name']}"
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    for suite, why in result["skipped"].items():
        console.print(f"suite {suite} was left out: {why}", markup=False)


def _value(figure) -> str:
    if figure["value"] is None:
        return "–"
    share = figure["hits"] is not None or "limit" in figure["name"]
    return f"{figure['value']:.1%}" if share else f"{figure['value']:.2f}"


def _interval(figure) -> str:
    if figure["low"] is None or not figure["cases"]:
        return ""
    return (
        f"{figure['low']:.1%} – {figure['high']:.1%}"
        if figure["hits"] is not None
        else (f"{figure['low']:.2f} – {figure['high']:.2f}")
    )
