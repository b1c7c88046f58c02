"""Starts the app on 127.0.0.1 and says where it is."""

import os
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from workbench.app.security import Gate, guard, new_token

HOST = "127.0.0.1"


@dataclass(frozen=True)
class Options:
    """port: 0 for any free one; browser: whether to open one; session: where session.toml is kept."""

    session: Path | None
    port: int = 0
    browser: bool = True


def serve(opened, options: Options, progress: Callable[[str], None] = print) -> None:
    """Serve the app until it is interrupted.

    opened: a `workbench.app.data.opened.Opened`, None to import one; progress: called with the address once the
    app can be reached.
    Raises InputError for a session that cannot be read or a port that is taken, ImportError without trame.
    """
    os.environ["WSLINK_READY_MSG"] = ""
    from trame.app import get_server

    from workbench.app.ui.page import build

    server = get_server(f"workbench-{new_token()[:8]}", client_type="vue3")
    page = build(server, opened, options.session)
    token = new_token()
    add_gate(server, token, page.folder_of)

    def announce(**_):
        address = f"http://{HOST}:{server.port}/?token={token}"
        progress(address)
        if options.browser:
            webbrowser.open(address)

    server.controller.on_server_ready.add(announce)
    _start(server, options.port)


def add_gate(server, token: str, folder_of: Callable[[str], Path | None]) -> None:
    """Let only requests with the token reach the app, and serve files of run folders under /runs/NUMBER."""

    def protect(web_server) -> None:
        middleware, send_file = guard(lambda: Gate(token, server.port), folder_of)
        web_server.app.middlewares.append(middleware)
        web_server.app.router.add_get("/runs/{run:[0-9]{1,6}}/{name:.*}", send_file)
        web_server.app.router.add_post("/paraview/", tell_session)

    server.controller.on_server_bind.add(protect)


async def tell_session(request):
    """Answer with the address of the websocket, which trame's page requests first; else the browser logs an error."""
    from aiohttp import web

    return web.json_response({"sessionURL": f"ws://{request.host}/ws"})


def _start(server, port: int) -> None:
    """Run the server; the words of our command line are not trame's."""
    import sys

    from workbench.core.errors import InputError

    words = sys.argv
    sys.argv = sys.argv[:1]
    try:
        server.start(
            port=port,
            host=HOST,
            open_browser=False,
            show_connection_info=False,
            disable_logging=True,
            timeout=0,
        )
    except OSError as problem:
        raise InputError(
            f"--port {port}: expected a free port, but the system says '{problem.strerror}'; choose another port or "
            "leave the option out"
        ) from None
    finally:
        sys.argv = words
