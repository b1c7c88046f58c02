"""Who may talk to the app: only a browser on this machine that was given the token.

Every request, also the one that opens the websocket, passes `Gate.check`:

- Host must be 127.0.0.1 or localhost with the app's port. Otherwise a foreign name that resolves to 127.0.0.1
  could read the app (DNS rebinding).
- Origin, where a browser sends it, must be the app itself; a websocket must send it. Otherwise any web page could
  connect (cross-site websocket hijacking).
- The token must be in the address (?token=…) or in the cookie that the first page set. The cookie is HttpOnly and
  SameSite=Strict and carries the port in its name, since cookies do not distinguish ports.
"""

import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

HOSTS = ("127.0.0.1", "localhost")
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws: blob: data:; "
        "worker-src 'self' blob:; "
        "frame-ancestors 'none'; base-uri 'self'; form-action 'none'; object-src 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
LIBRARIES = "/__trame_"
"""Addresses of libraries begin with this and hold their version: the browser may keep them, and their compiled code."""


def new_token() -> str:
    """256 random bits for the address of the app."""
    return secrets.token_urlsafe(32)


@dataclass(frozen=True)
class Gate:
    """Decides on requests to the app at `port` with `token`."""

    token: str
    port: int

    @property
    def cookie(self) -> str:
        """Name of the cookie that carries the token."""
        return f"workbench-{self.port}"

    def check(
        self, headers: Mapping, query: Mapping, cookies: Mapping, is_websocket: bool
    ) -> str | None:
        """Why a request is refused; None where it is allowed."""
        if not self._is_own_host(headers.get("Host", "")):
            return "The Host of this request is not the app's address."
        origin = headers.get("Origin")
        if (origin is None and is_websocket) or (
            origin is not None and not self._is_own_origin(origin)
        ):
            return "This request comes from another web page."
        given = query.get("token") or cookies.get(self.cookie) or ""
        if not self.is_token(given):
            return "The token is missing or wrong; use the address that workbench open printed."
        return None

    def is_token(self, given: str) -> bool:
        """Whether a text is the token, compared in constant time."""
        return hmac.compare_digest(given.encode("utf-8"), self.token.encode("utf-8"))

    def _is_own_host(self, host: str) -> bool:
        return host in {f"{name}:{self.port}" for name in HOSTS}

    def _is_own_origin(self, origin: str) -> bool:
        address = urlsplit(origin)
        return (
            address.scheme == "http"
            and self._is_own_host(address.netloc)
            and not address.path.strip("/")
        )


def resolve_inside(folder: Path, name: str) -> Path | None:
    """The file `name` below `folder`; None for what does not exist or lies outside, also through a link."""
    if not name or "\x00" in name or "\\" in name or Path(name).is_absolute():
        return None
    folder = folder.resolve()
    path = (folder / name).resolve()
    return path if path.is_relative_to(folder) and path.is_file() else None


def guard(gate_of, folder_of):
    """aiohttp middleware that refuses what the gate refuses, and the handler of files of the run.

    gate_of: gives the `Gate`, once the port is known; folder_of: gives the folder of the run that an address names by
    its number, whose files may be read; None where there is no such run.
    """
    from aiohttp import web

    @web.middleware
    async def refuse_or_handle(request, handler):
        gate = gate_of()
        is_websocket = request.headers.get("Upgrade", "").lower() == "websocket"
        refusal = gate.check(request.headers, request.query, request.cookies, is_websocket)
        if refusal is not None:
            return web.Response(status=403, text=refusal, headers=HEADERS)
        try:
            response = await handler(request)
        except web.HTTPException as raised:
            response = raised
        _complete(response, request, gate)
        if isinstance(response, web.HTTPException):
            raise response
        return response

    async def send_file(request):
        folder = folder_of(request.match_info["run"])
        path = None if folder is None else resolve_inside(folder, request.match_info["name"])
        if path is None:
            return web.Response(
                status=404, text="There is no such file in the opened folder.", headers=HEADERS
            )
        return web.FileResponse(path)

    return refuse_or_handle, send_file


def _complete(response, request, gate: Gate) -> None:
    """Add the security headers and, where the address carries the token, the cookie."""
    if response.prepared:
        return
    if request.path.startswith(LIBRARIES) and response.status == 200:
        response.headers["Cache-Control"] = "private, max-age=31536000, immutable"
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
    if gate.is_token(request.query.get("token", "")):
        response.set_cookie(gate.cookie, gate.token, httponly=True, samesite="Strict", path="/")
