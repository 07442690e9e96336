"""``gtau app``: the server of the page, on this machine alone and for those who hold its token."""

from __future__ import annotations

import secrets
import socket
from http.cookies import SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs

from gtau.documents.files import folder_of
from gtau.doors.command import within
from gtau.errors import GtauError, needing

HOST = "127.0.0.1"
CLOSED = "This page needs the address that 'gtau app' printed, with its token."


class Guard:
    """Let only those in who hold the token: in the address at first, then in a cookie of this port."""

    def __init__(self, app: Any, token: str, port: int, largest: int) -> None:
        self.largest = largest + (1 << 20)  # with what a form adds
        self.app, self.token, self.cookie = app, token, f"gtau_{port}"
        self.hosts = {f"{name}:{port}".encode() for name in (HOST, "localhost")}

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer a request, or hand it on."""
        from starlette.responses import PlainTextResponse

        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        cookie = SimpleCookie(headers.get(b"cookie", b"").decode("latin-1")).get(self.cookie)
        held = cookie.value if cookie else ""
        shown = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        origin = headers.get(b"origin", b"").rpartition(b"/")[2]  # another page's request carries its own
        known = any(secrets.compare_digest(key.encode(), self.token.encode()) for key in (shown, held))
        if not known or headers.get(b"host") not in self.hosts or origin not in (b"", *self.hosts):
            await self._refuse(scope, receive, send, PlainTextResponse(CLOSED, 403))
        elif int(headers.get(b"content-length", b"0")) > self.largest:
            await self._refuse(scope, receive, send, PlainTextResponse("The file is too large.", 413))
        else:

            async def with_cookie(message: Any) -> None:
                if message["type"] == "http.response.start" and shown:
                    cookie = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                    message["headers"] = [*message.get("headers", ()), (b"set-cookie", cookie.encode())]
                await send(message)

            await self.app(scope, receive, with_cookie)

    async def _refuse(self, scope: Any, receive: Any, send: Any, response: Any) -> None:
        if scope["type"] == "http":
            await response(scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": 1008})


def serve(folder: Path, port: int, show: bool) -> None:
    """Serve the page of a project until Ctrl-C; raises GtauError."""
    with needing("the page", "nicegui", "app"):
        from nicegui import app, ui
        from starlette.responses import FileResponse, PlainTextResponse

        from gtau.doors.page import LARGEST, draw
        from gtau.doors.project import Project

    folder_of(folder)
    if not port:
        with socket.create_server((HOST, 0)) as probe:
            port = int(probe.getsockname()[1])
    token, project = secrets.token_urlsafe(24), Project(folder.resolve())
    app.add_middleware(Guard, token=token, port=port, largest=LARGEST)

    @app.get("/files/{name:path}")
    def file(name: str) -> Any:
        try:
            path = within(project.folder, name)
        except GtauError as error:
            return PlainTextResponse(str(error), 403)
        return FileResponse(path) if path.is_file() else PlainTextResponse(f"there is no file {name}.", 404)

    @ui.page("/", title=f"gtau: {project.folder.name}")
    def page() -> None:
        draw(project)

    app.on_shutdown(project.cancel)
    print(f"gtau: the page of {folder} is at http://{HOST}:{port}/?token={token} (Ctrl-C ends it)", flush=True)
    try:
        ui.run(
            host=HOST,
            port=port,
            show=f"/?token={token}" if show else False,
            reload=False,
            dark=None,
            show_welcome_message=False,
            reconnect_timeout=30.0,
            uvicorn_logging_level="critical",  # a reader that leaves early is no error
        )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"the page is closed, and {folder} holds all that it wrote") from None
