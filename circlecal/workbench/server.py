"""The workbench's server: the page and what it asks for, on this machine only.

Every address begins with a token that nobody else knows; the Host header must be this machine, and a request that comes
from another page (Origin, Sec-Fetch-Site) is refused. Frames are asked for by their number in the list, so no path
comes from outside. The content security policy lets the page load what this server gives and nothing else.
"""

from __future__ import annotations

import json
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from circlecal.errors import CirclecalError
from circlecal.formats.annotation import Annotation
from circlecal.formats.registry import annotation_formats
from circlecal.records.json_text import validate_json
from circlecal.workbench.address import PageAddress, keep_address, make_address, recall_address
from circlecal.workbench.page_field import describe_field
from circlecal.workbench.session import Session
from circlecal.workbench.store import NewerError

PAGE = Path(__file__).parent / "page"
SHARED = tuple(Path(__file__).parents[1] / "report" / "assets" / name for name in ("report.css", "camera.js"))
"""Of the report, whose look and mathematics the page shares."""
LOCAL = "127.0.0.1"
MOST_BYTES = 64 << 20
"""Of one request; a file of annotations of a whole season is smaller."""
MOST_LINES = 20
"""Of what an export left out, since a header is short."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
OF_EARLIER_START = (
    "This page is of an earlier start of circlecal annotate. Open the address that it printed last; what was not saved "
    "here is kept in this browser and taken up there."
)
_OWN_SITES = ("none", "same-origin")
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
_HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class _Change(BaseModel):
    """A changed annotation, and the revision that it was made from."""

    model_config = ConfigDict(extra="forbid")

    base: int = Field(ge=0)
    annotation: Annotation


class _Mark(BaseModel):
    """A click, a drag or the clicks on a circle."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    mode: str
    name: str | None = None
    points: list[tuple[float, float]] = Field(min_length=1, max_length=2000)


class _Desk:
    """Answers to requests of the page, from a session and the page's own files."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.start = secrets.token_hex(4)  # another one after each start
        self.files = {file.name: file.read_bytes() for file in (*PAGE.iterdir(), *SHARED)}

    async def page(self, request: Request) -> Response:
        name = request.path_params.get("name") or "index.html"
        if name not in self.files:
            return tell_missing(request)
        return Response(self.files[name], media_type=_TYPES[Path(name).suffix])

    async def listing(self, request: Request) -> Response:
        writable = sorted(name for name, f in annotation_formats().items() if f.write is not None)
        field, folder = describe_field(self.session.template), str(self.session.store.folder.absolute())
        return _json(
            {
                "frames": self.session.listing(), "field": field, "formats": writable, "folder": folder,
                "start": self.start,
            }
        )  # fmt: skip

    async def picture(self, request: Request) -> Response:
        content = await run_in_threadpool(self.session.picture, request.path_params["index"])
        return Response(content, media_type="image/jpeg")

    async def show(self, request: Request) -> Response:
        return _json(await run_in_threadpool(self.session.show, request.path_params["index"]))

    async def save(self, request: Request) -> Response:
        change, index = validate_json(_Change, await _body(request)), request.path_params["index"]
        try:
            saved = await run_in_threadpool(self.session.save, index, change.annotation, change.base)
        except NewerError as error:
            return _json({"error": str(error), "current": error.current.model_dump(mode="json")}, 409)
        return _json(saved)

    async def mark(self, request: Request) -> Response:
        wanted, index = _Mark.model_validate_json(await _body(request)), request.path_params["index"]
        points = np.array(wanted.points, dtype=np.float64)
        found = await run_in_threadpool(self.session.snap, index, points, wanted.mode, wanted.name)
        snapped, sigma = np.round(found.points, 3).tolist(), np.round(found.sigma, 4).tolist()
        return _json({"points": snapped, "sigma": sigma, "on_paint": found.on_paint})

    async def interpretations(self, request: Request) -> Response:
        found = await run_in_threadpool(self.session.interpretations, request.path_params["index"])
        return _json([one.describe() for one in found])

    async def origin(self, request: Request) -> Response:
        opened = await run_in_threadpool(self.session.open, request.path_params["index"])
        return _json([marking.model_dump(mode="json") for marking in opened.begun.markings])

    async def export(self, request: Request) -> Response:
        found = await run_in_threadpool(self.session.export, request.path_params["name"])
        told = found.left_out[:MOST_LINES]
        told += [f"and {len(found.left_out) - len(told)} more"] if len(told) < len(found.left_out) else []
        headers = {
            "Content-Disposition": f'attachment; filename="{found.name}"',
            "Circlecal-Left-Out": json.dumps(told),
        }
        return Response(found.content, media_type="application/octet-stream", headers=headers)

    async def take_in(self, request: Request) -> Response:
        content, name = await _body(request), request.query_params.get("name", "file.json")
        return _json(await run_in_threadpool(self.session.take_in, name, content))


def make_app(session: Session, token: str, port: int) -> Starlette:
    """The application of a session.

    Parameters
    ----------
    session : Session
        Frames and annotations.
    token : str
        First part of every address.
    port : int
        On which it is served, as the Host header must say.
    """
    desk, prefix = _Desk(session), f"/{token}"
    routes = [
        Route(f"{prefix}/", desk.page),
        Route(f"{prefix}/frames.json", desk.listing),
        Route(f"{prefix}/frames/{{index:int}}.jpg", desk.picture),
        Route(f"{prefix}/frames/{{index:int}}.json", desk.show),
        Route(f"{prefix}/frames/{{index:int}}.json", desk.save, methods=["PUT"]),
        Route(f"{prefix}/frames/{{index:int}}/mark", desk.mark, methods=["POST"]),
        Route(f"{prefix}/frames/{{index:int}}/interpretations", desk.interpretations),
        Route(f"{prefix}/frames/{{index:int}}/measured", desk.origin),
        Route(f"{prefix}/export/{{name}}", desk.export),
        Route(f"{prefix}/import", desk.take_in, methods=["POST"]),
        Route(f"{prefix}/{{name}}", desk.page),
    ]
    app = Starlette(
        routes=routes,
        exception_handlers={CirclecalError: _tell, ValidationError: _tell_invalid, 404: tell_missing},
    )
    app.add_middleware(Guard, hosts=frozenset({f"{LOCAL}:{port}", f"localhost:{port}"}))
    return app


class Guard:
    """Refuses what does not come from this machine's own page, and adds the headers that keep the page to itself."""

    def __init__(self, app: Any, hosts: frozenset[str]) -> None:
        self.app = app
        self.hosts = hosts

    async def __call__(self, scope: Any, receive: Any, send: Callable[[Any], Any]) -> None:
        """Handle one request (ASGI)."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def send_safe(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [
                    *message["headers"],
                    *((name.lower().encode(), value.encode()) for name, value in _HEADERS.items()),
                ]
            await send(message)

        request = Request(scope)
        if not self._is_own(request):
            await _problem("this address answers its own page only", 403)(scope, receive, send_safe)
            return
        await self.app(scope, receive, send_safe)

    def _is_own(self, request: Request) -> bool:
        origin = request.headers.get("origin")
        own_origin = origin is None or origin.removeprefix("http://") in self.hosts
        site = request.headers.get("sec-fetch-site", "none")
        return request.headers.get("host") in self.hosts and own_origin and (site in _OWN_SITES or _is_link(request))


def _is_link(request: Request) -> bool:
    """Whether a person followed a link to the page, as from a report; the token is in it, and nothing is changed."""
    wanted = ("GET", "navigate", "document")
    return (
        request.url.path.count("/") == 2
        and request.url.path.endswith("/")
        and wanted
        == (
            request.method,
            request.headers.get("sec-fetch-mode"),
            request.headers.get("sec-fetch-dest"),
        )
    )


async def _body(request: Request) -> bytes:
    """What was sent.

    Raises
    ------
    CirclecalError
        It is too much.
    """
    parts, size = [], 0
    async for part in request.stream():
        size += len(part)
        if size > MOST_BYTES:
            raise CirclecalError(f"more than {MOST_BYTES >> 20} MB were sent")
        parts.append(part)
    return b"".join(parts)


def _json(content: Any, status: int = 200) -> Response:
    """JSON in ASCII: names of files need not be text."""
    return Response(json.dumps(content, allow_nan=False), status, media_type="application/json")


def _problem(text: str, status: int) -> Response:
    return _json({"error": text}, status)


def tell_missing(request: Request, error: Exception | None = None) -> Response:
    """That there is no such page, mostly since its address is of an earlier start; to people with what to do."""
    if "text/html" not in request.headers.get("accept", ""):
        return _problem(OF_EARLIER_START, 404)
    page = f"<!DOCTYPE html><html lang=en><title>circlecal workbench</title><p>{OF_EARLIER_START}</p></html>"
    return Response(page, 404, media_type="text/html")


def _tell(request: Request, error: Exception) -> Response:
    return _problem(str(error), 400)


def _tell_invalid(request: Request, error: Exception) -> Response:
    if not isinstance(error, ValidationError):
        return _problem(str(error), 400)
    first = error.errors(include_url=False, include_context=False)[0]
    return _problem(f"{'.'.join(map(str, first['loc']))}: {first['msg']}", 400)


def bind(port: int) -> socket.socket:
    """A socket on this machine's own address; port 0 takes a free one.

    Raises
    ------
    CirclecalError
        The port is taken.
    """
    found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        found.bind((LOCAL, port))
        found.listen()  # whoever is told the address can connect at once
    except OSError as error:
        found.close()
        raise CirclecalError(f"--port {port}: {error.strerror}; choose another, or none for any free one") from error
    return found


def _bind_again(port: int, folder: Path, part: str | None) -> tuple[socket.socket, str]:
    """A socket and the token of its page: those of the last start for a folder where they are free, so that a page that
    is still open goes on.

    Raises
    ------
    CirclecalError
        The port is taken.
    """
    before = recall_address(folder, part)
    if before is not None and port in (0, before.port):
        try:
            return bind(before.port), before.token
        except CirclecalError:  # served still, or by another program
            return bind(port), make_address().token
    new = make_address()
    listener = bind(port)
    keep_address(folder, part, PageAddress(listener.getsockname()[1], new.token))
    return listener, new.token


def serve(session: Session, port: int, on_ready: Callable[[str], None], part: str | None = None) -> None:
    """Serve until Ctrl-C.

    Parameters
    ----------
    session : Session
        Frames and annotations.
    port : int
        On which; 0 for any free one.
    on_ready : callable
        Called with the address of the page.
    part : str, optional
        Which part of the frames is served, such as ``"2/4"``; each has a page of its own.

    Raises
    ------
    CirclecalError
        The port is taken.
    """
    listener, token = _bind_again(port, session.store.folder, part)
    port = listener.getsockname()[1]
    app = make_app(session, token, port)
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", access_log=False, lifespan="off"))
    on_ready(f"http://{LOCAL}:{port}/{token}/")
    server.run([listener])
