"""`workbench open`: the local app on a run or a recording."""

from pathlib import Path
from typing import Annotated

import typer

Subject = Annotated[
    str | None,
    typer.Argument(
        metavar="[RUN|RECORDING]",
        help="Folder of a run, folder of a recording or a known name. Default: the newest run under runs/, or the "
        "import wizard if there is none.",
    ),
]


def command(
    subject: Subject = None,
    port: Annotated[
        int,
        typer.Option("--port", min=0, max=65535, help="Port on 127.0.0.1; 0 takes any free one."),
    ] = 0,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address without opening a browser.")
    ] = False,
    recording: Annotated[
        str | None,
        typer.Option(
            "--recording",
            metavar="RECORDING",
            help="Folder of the recording, if it was moved after the run.",
        ),
    ] = None,
    session: Annotated[
        Path | None,
        typer.Option("--session", metavar="FILE", help="File of the edits (session.toml)."),
    ] = None,
) -> None:
    """Show a run or a recording in the browser: robot, residuals, images; exclude samples and calibrate again.

    The page is served on 127.0.0.1 only; nothing is fetched from the network. The edits are kept in a session.toml,
    which `workbench calibrate --session` repeats (`camera` and `handeye --session` those of their runs).
    """
    import trame_plotly  # noqa: F401  reported as a missing package before anything is read
    import trame_vuetify  # noqa: F401

    from workbench.app.data.opened import open_subject
    from workbench.app.edits.session import session_path
    from workbench.app.server import Options, serve

    opened = None if _is_first(subject, recording) else open_subject(subject, recording)
    path = session or (None if opened is None else session_path(opened.subject, opened.command))
    serve(opened, Options(path, port, not no_browser), lambda text: print(text, flush=True))


def _is_first(subject: str | None, recording: str | None) -> bool:
    """Whether nothing is named and there is no run yet: the app then starts with the import."""
    from workbench.app.data.opened import finished_runs

    return subject is None and recording is None and not finished_runs()
