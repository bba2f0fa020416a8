"""Server of the window: on the loopback address only, with a token that every request needs."""

from __future__ import annotations

import os
import secrets
import socket
import webbrowser
from http.cookies import SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from ..errors import InputError, naming_extra
from ..line_log import LineLog
from .session import Session

HOST = "127.0.0.1"
COOKIE = "hframe_token"
# Nothing of the page comes from another address than the server's, and no other page may show it in a frame.
_POLICY = (
    "default-src 'self' data: blob:; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; connect-src 'self' {socket}; frame-ancestors 'self'"
)
_SHARED = "/session"  # address of the session's files
_REFUSED = b"Open the address that hframe app printed; it has the token that this page needs.\n"


class TokenGate:
    """Layer of a web application (ASGI) that answers only who has the token, and only on the loopback.

    The first request has the token in its address; a cookie then keeps it. The name of the host is compared
    as well, so that another site cannot reach the server under a name of its choice.
    """

    def __init__(self, app: Any, token: str, port: int) -> None:
        """Wrap an application (ASGI) on a port of the server; requests must have the token."""
        self._app, self._token, self._port = app, token, port
        self._hosts = {f"{name}:{port}" for name in (HOST, "localhost")}

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer a request, or pass it on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        in_address = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        kept = SimpleCookie(headers.get("cookie", "")).get(f"{COOKIE}_{self._port}")
        by_address = secrets.compare_digest(in_address.encode(), self._token.encode())
        by_cookie = kept is not None and secrets.compare_digest(kept.value.encode(), self._token.encode())
        origin = headers.get("origin", "").partition("//")[2]
        trusted = headers.get("host") in self._hosts and origin in ("", *self._hosts)
        if not (trusted and (by_address or by_cookie)):
            await self._refuse(scope, send)
            return

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                extra = [
                    (b"content-security-policy", _POLICY.format(socket=f"ws://{headers['host']}").encode())
                ]
                extra.append((b"referrer-policy", b"no-referrer"))
                if by_address:
                    cookie = f"{COOKIE}_{self._port}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    extra.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        await self._app(scope, receive, with_headers)

    async def _refuse(self, scope: Any, send: Any) -> None:
        """Refuse a request or a connection."""
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
            return
        headers = [(b"content-type", b"text/plain; charset=utf-8")]
        await send({"type": "http.response.start", "status": 403, "headers": headers})
        await send({"type": "http.response.body", "body": _REFUSED})


def serve(folder: Path, port: int, *, open_browser: bool, log: LineLog) -> None:
    """Serve the window of a session until the process is interrupted.

    Args:
        port: Port; 0 for any free one.

    Raises:
        ImportError: If the extra `app` is not installed.
        InputError: If the folder is a file, or the port is in use.
    """
    session = Session(folder.resolve())
    # The library would otherwise make a folder in the current one.
    os.environ.setdefault("NICEGUI_STORAGE_PATH", str(session.path(".window")))
    with naming_extra("app", "the window needs more packages"):
        import uvicorn
        from fastapi import FastAPI
        from nicegui import ui
        from starlette.staticfiles import StaticFiles
    from .window import Window

    session.create()
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere, the option would let two servers have one port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((HOST, port))
        listener.listen()  # requests wait until the server has started
    except OSError as error:
        raise InputError(
            f"--port {port}: {error.strerror}; choose another one, or 0 for any free port"
        ) from None
    port = listener.getsockname()[1]
    token = secrets.token_urlsafe(16)
    application = FastAPI(openapi_url=None)
    application.mount(_SHARED, StaticFiles(directory=session.folder))
    window = Window(session)
    ui.page("/", title=f"hframe: {session.folder.name}", response_timeout=30.0)(window.page)
    ui.run_with(
        application, title="hframe", dark=None, favicon="data:,", tailwind=False, show_welcome_message=False
    )
    application.add_middleware(TokenGate, token=token, port=port)
    address = f"http://{HOST}:{port}/?token={token}"
    log(f"session {session.folder}")
    log(f"open {address}")
    log("Ctrl-C ends the window; the session stays")
    if open_browser:
        webbrowser.open(address)
    server = uvicorn.Server(uvicorn.Config(application, log_level="warning", timeout_graceful_shutdown=1))
    try:
        server.run(sockets=[listener])
    finally:
        for job in window.jobs.values():
            if job.running:
                job.stop()
