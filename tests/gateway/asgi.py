"""A browser without a network: requests and websockets played straight into the application."""

import asyncio
import contextlib
import json

HOST = "127.0.0.1:8090"


def _scope(kind, path, host, origin, token, more=()):
    headers = [(b"host", host.encode()), *more]
    if origin is not None:
        headers.append((b"origin", origin.encode()))
    if token is not None:
        headers.append((b"authorization", f"Bearer {token}".encode()))
    path, _, query = path.partition("?")
    plain = {"http_version": "1.1", "raw_path": path.encode(), "query_string": query.encode(), "root_path": ""}
    return {"type": kind, "path": path, "headers": headers, "scheme": "http", **plain}


async def request(
    app, path, *, method="GET", body=None, host=HOST, origin=None, token=None, content="application/json"
):
    """Status, headers and body of the answer."""
    sent, text = [], b"" if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
    waiting = [{"type": "http.request", "body": text, "more_body": False}]

    async def receive():
        return waiting.pop(0) if waiting else await asyncio.Event().wait()

    async def send(message):
        sent.append(message)

    scope = _scope("http", path, host, origin, token, [(b"content-type", content.encode())]) | {"method": method}
    await app(scope, receive, send)
    headers = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return sent[0]["status"], headers, b"".join(message.get("body", b"") for message in sent[1:])


class Browser:
    """One websocket; `told` are all messages so far, JSON as objects and binary as bytes."""

    def __init__(self, app, *, host=HOST, origin=f"http://{HOST}"):
        self._to_app, self.told, self.closed, self._news = asyncio.Queue(), [], None, asyncio.Event()
        scope = _scope("websocket", "/live", host, origin, None) | {"subprotocols": []}
        self._to_app.put_nowait({"type": "websocket.connect"})
        self._task = asyncio.create_task(app(scope, self._to_app.get, self._sent))

    async def _sent(self, message):
        if message["type"] == "websocket.close":
            self.closed = message["code"]
        elif message["type"] == "websocket.send":
            self.told.append(message["bytes"] if message.get("bytes") is not None else json.loads(message["text"]))
        self._news.set()

    def say(self, message):
        text = message if isinstance(message, str) else json.dumps(message)
        self._to_app.put_nowait({"type": "websocket.receive", "text": text})

    async def heard(self, wanted, patience_s=60.0):
        """The first message from here on of which `wanted(message)` is true."""
        at = 0
        async with asyncio.timeout(patience_s):
            while True:
                for message in self.told[at:]:
                    if wanted(message):
                        return message
                at = len(self.told)
                self._news.clear()
                await self._news.wait()

    async def ended(self):
        async with asyncio.timeout(60.0):
            while self.closed is None:
                self._news.clear()
                await self._news.wait()
        return self.closed

    async def leave(self):
        self._to_app.put_nowait({"type": "websocket.disconnect", "code": 1001})
        with contextlib.suppress(asyncio.CancelledError):
            await self._task
