"""The web application: pages for everybody; with a token live connection, status, orders, traces and metrics."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import json
import tempfile
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from string import Template
from typing import Any

from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from micromanip.errors import DeviceUnavailable, MicromanipError, PermissionDenied, UsageError

from .cell import Cell, Source
from .guard import ORDERS_PATH, Guard, Origins
from .metrics import Metrics
from .response import response_of
from .saving import save_recording
from .session import MESSAGE_BYTES, Session
from .tokens import Token, Tokens
from .views import number

PAGES = Path(__file__).with_name("pages")
PATHS = {"cell": "/", "scope": "/scope", "moves": "/moves"}
"""Where each page is; their names stand in this order above each."""
ORDERS = ("arm", "hold", "disarm", "reset")
MOVE_FIELDS = {"axis", "kind", "by_um", "returns", "way_s", "rest_s", "amplitude_um", "frequency_Hz", "to_Hz"}
MOVE_FIELDS |= {"seconds", "places_um", "number", "stop"}
_HELLO_S = 10.0
_BODY_BYTES, _BODY_S = 4096, 10.0
_MOST_SAVING, _SENT_S = 2, 300.0
"""So many recordings are saved at a time, for each of them some 8 MB; each must be taken within this time."""
_STATUS = {1: 409, 64: 400, 69: 503, 77: 403, 78: 409}
"""HTTP status by the exit code of an error."""
_POLICY, _PROBLEM = 1008, 1003
Beside = Callable[[], contextlib.AbstractAsyncContextManager[None]]


class Gateway:
    """Serves one cell."""

    def __init__(
        self,
        cell: Cell,
        tokens: Tokens,
        origins: Origins,
        differs: Callable[[], str | None],
        beside: Beside = contextlib.nullcontext,
        home: str = "cell",
        expiries: Callable[[], Mapping[str, float]] = dict,
    ) -> None:
        """`differs` says so where the controller runs another configuration than was expected, else None.

        What `beside` gives is entered as long as the pages are served; `home` is the page that the address alone shows.
        `expiries` are those of `Metrics`.
        """
        self._cell, self._tokens, self._differs, self._beside = cell, tokens, differs, beside
        self._saving = asyncio.Semaphore(_MOST_SAVING)
        """Places for recordings that are being saved or sent."""
        routes = [
            *(Route(path, _page(home if path == "/" else name)) for name, path in PATHS.items()),
            Route("/api/status", self._status),
            Route(ORDERS_PATH, self._order, methods=["POST"]),
            Route("/api/seen", self._seen, methods=["POST"]),
            Route("/api/move", self._move, methods=["POST"]),
            Route("/api/response", self._response, methods=["POST"]),
            Route("/api/recording", self._recording, methods=["POST"]),
            Route("/metrics", self._metrics),
            WebSocketRoute("/live", self._live),
            Route("/live", _without_upgrade),
            Mount("/static", StaticFiles(directory=PAGES)),
        ]
        handlers: Any = {MicromanipError: _refused}
        self.guard = Guard(Starlette(routes=routes, lifespan=self._alive, exception_handlers=handlers), origins)
        self._collected = Metrics(cell, lambda: self.guard.connections, lambda: self.guard.refused, expiries)

    @contextlib.asynccontextmanager
    async def _alive(self, _: Starlette) -> AsyncIterator[None]:
        following = asyncio.create_task(self._cell.follow())
        # what spectra need takes more than a second to load: the first spectrum would wait for it
        asyncio.get_running_loop().run_in_executor(None, importlib.import_module, "scipy.signal")
        async with self._beside():
            yield
        following.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await following

    def _known(self, connection: HTTPConnection, *, operates: bool = False) -> Token:
        """The token of a request, out of its header; PermissionDenied without."""
        scheme, _, secret = connection.headers.get("authorization", "").partition(" ")
        token = self._tokens.find(secret.strip()) if scheme.lower() == "bearer" else None
        if token is None:
            raise PermissionDenied(_without_token(secret, connection.url.query))
        if operates and not token.operates:
            raise PermissionDenied(f"{token.name} may only observe; this takes a token whose scope is operate")
        return token

    async def _status(self, request: Request) -> Response:
        self._known(request)
        return JSONResponse({"status": self._cell.status, "problem": self._cell.problem})

    async def _order(self, request: Request) -> Response:
        token = self._known(request, operates=True)
        order = (await _body(request)).get("order")
        if order not in ORDERS:
            raise UsageError(f"an order is one of {', '.join(ORDERS)}, not {order!r:.40}")
        await self._cell.order(order, token.name)
        return JSONResponse({"accepted": True})

    async def _seen(self, request: Request) -> Response:
        self._known(request, operates=True)
        await _body(request)
        self._cell.seen()
        return JSONResponse({"accepted": True})

    async def _move(self, request: Request) -> Response:
        token = self._known(request, operates=True)
        query = await _body(request)
        if unknown := set(query) - MOVE_FIELDS:
            raise UsageError(f"a move has no {min(unknown)!r:.40}")
        return JSONResponse(await self._cell.order("move", token.name, **query))

    async def _response(self, request: Request) -> Response:
        self._known(request)
        query = await _body(request)
        return JSONResponse(response_of(self._source(), query))

    def _source(self) -> Source:
        if self._cell.source is None:
            raise UsageError("there is nothing to save: no controller has been seen yet")
        return self._cell.source

    async def _recording(self, request: Request) -> Response:
        token = self._known(request)
        query = await _body(request)
        first, last = (round(number(query, name, 0, 2**53)) for name in ("first", "last"))
        source = self._source()
        if self._saving.locked():
            raise DeviceUnavailable(f"{_MOST_SAVING} recordings are being saved already; try again in a moment")
        with contextlib.ExitStack() as held:  # until it is sent
            await self._saving.acquire()
            held.callback(self._saving.release)
            folder = held.enter_context(tempfile.TemporaryDirectory(prefix="micromanip-gateway-"))
            configuration = await self._cell.order("configuration", token.name)
            file = Path(folder) / f"scope-{last}.mcap"
            await save_recording(source, configuration, first, last, file)
            return _Sent(file, held.pop_all().close)

    async def _metrics(self, request: Request) -> Response:
        self._known(request)
        return Response(self._collected.text(), media_type=self._collected.media_type)

    async def _live(self, websocket: WebSocket) -> None:
        await websocket.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # RuntimeError: it was closed while we sent
            token = await self._greeted(websocket)
            if token is None:
                await websocket.close(_POLICY, "wrong token")
                return
            session = Session(self._cell, token, lambda message: _sent(websocket, message), self._differs)
            sending = asyncio.create_task(session.run())
            try:
                await self._listen(websocket, session, sending)
            finally:
                sending.cancel()
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                    await sending

    async def _greeted(self, websocket: WebSocket) -> Token | None:
        """The token of the first message, which has to come soon."""
        try:
            async with asyncio.timeout(_HELLO_S):
                hello = json.loads(await websocket.receive_text())
        except (TimeoutError, ValueError, KeyError):
            return None
        secret = hello.get("token") if isinstance(hello, dict) else None
        return self._tokens.find(secret) if isinstance(secret, str) else None

    @staticmethod
    async def _listen(websocket: WebSocket, session: Session, sending: asyncio.Task[None]) -> None:
        while not sending.done():
            text = await websocket.receive_text()
            if len(text) > MESSAGE_BYTES:
                await websocket.close(_PROBLEM, "the message is too long")
                return
            try:
                session.hear(text)
            except MicromanipError as problem:
                await websocket.send_text(json.dumps({"type": "problem", "problem": str(problem)}))


class _Sent(FileResponse):
    """A file that is let go of when it was sent, or could not be, or was not taken in time."""

    def __init__(self, file: Path, done: Callable[[], None]) -> None:
        super().__init__(file, media_type="application/octet-stream", filename=file.name)
        self._done = done

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            async with asyncio.timeout(_SENT_S):
                await super().__call__(scope, receive, send)
        finally:
            self._done()


async def _sent(websocket: WebSocket, message: str | bytes) -> None:
    if isinstance(message, bytes):
        await websocket.send_bytes(message)
    else:
        await websocket.send_text(message)


async def _body(request: Request) -> dict[str, Any]:
    """A document of JSON. A form of a foreign page can't send one: its type would have to be asked for first."""
    if request.headers.get("content-type", "").partition(";")[0].strip() != "application/json":
        raise UsageError("this takes a body of application/json")
    text = b""
    try:
        async with asyncio.timeout(_BODY_S):
            async for chunk in request.stream():
                text += chunk
                if len(text) > _BODY_BYTES:
                    raise UsageError(f"a body is at most {_BODY_BYTES} bytes long")
    except TimeoutError:
        raise UsageError(f"the body was not whole within {_BODY_S:g} s") from None
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise UsageError("this takes an object of JSON")
    return document


async def _refused(request: Request, problem: Exception) -> Response:
    assert isinstance(problem, MicromanipError)
    unknown = isinstance(problem, PermissionDenied) and "authorization" not in request.headers
    status = 401 if unknown else _STATUS.get(problem.exit_code, 500)
    headers = {"www-authenticate": "Bearer"} if status == 401 else None
    if request.url.path == "/metrics":
        return PlainTextResponse(f"{problem}\n", status, headers)
    return JSONResponse({"error": str(problem)}, status, headers)


async def _without_upgrade(_: Request) -> Response:
    why = "this is the live connection, a WebSocket: a proxy has to pass on the headers Upgrade and Connection\n"
    return PlainTextResponse(why, 426, {"upgrade": "websocket", "connection": "Upgrade"})


def _page(name: str) -> Callable[[Request], Any]:
    """The page `name`: what stands in its file, in the frame that all pages have."""
    frame, content = ((PAGES / f"{each}.html").read_text(encoding="utf-8") for each in ("frame", name))
    here = ' aria-current="page"'
    links = "".join(f'<a href="{p}"{here if n == name else ""}>{n.capitalize()}</a>' for n, p in PATHS.items())
    state = "" if name == "cell" else '<b id="state"></b>'  # there it is larger
    whole = Template(frame).substitute(title=name.capitalize(), name=name, links=links, state=state, content=content)

    async def page(_: Request) -> Response:
        return HTMLResponse(whole)

    return page


def _without_token(secret: str, query: str) -> str:
    """Why a request is turned away that has no token, a wrong one, or one in its address."""
    takes = "this takes a token: Authorization: Bearer TOKEN"
    if "token" in query.lower():
        return f"{takes}. One in an address is not taken: addresses stand in logs; let it be replaced by a new one"
    return "this token is not known here: the gateway read its file of tokens as it started" if secret else takes
