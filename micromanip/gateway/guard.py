"""What stands before every request: how many there are, which host and page they are meant for, what a page may load.

A browser tells the truth about `Host` and `Origin`. A foreign page can't read our answers, but it could have a
browser send requests; a name that an attacker owns could be made to point at this computer (DNS rebinding). So both
must be ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_CONNECTIONS = 200
ORDERS_PATH, _FOR_ORDERS = "/api/order", 20
"""So many connections more are for who has an order to give."""
_HEADERS = [
    (b"content-security-policy", b"default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cache-control", b"no-cache"),
]
_PORTS = {"http": 80, "https": 443}
_LOCAL = ("localhost", "127.0.0.1", "[::1]")


@dataclass(frozen=True)
class Origins:
    """Where this gateway is found: `public` as a proxy shows it, else `scheme` and host as they are.

    Without TLS and proxy only names of this computer are let in. With TLS any: a browser holds them against the
    certificate.
    """

    scheme: str = "http"
    public: str | None = None

    @classmethod
    def behind(cls, address: str) -> Origins:
        """Those of a proxy that people open as `address`, written as browsers do; ValueError for no such address."""
        split = urlsplit(address)
        if (
            split.scheme not in _PORTS
            or not split.hostname
            or split.path not in ("", "/")
            or split.query
            or split.username
        ):
            raise ValueError(address)
        host = f"[{split.hostname}]" if ":" in split.hostname else split.hostname
        port = "" if split.port in (None, _PORTS[split.scheme]) else f":{split.port}"
        return cls(public=f"{split.scheme}://{host}{port}")

    def is_ours(self, host: str, origin: str | None) -> bool:
        """Whether a request for `host`, from a page of `origin` (None: from no page), is meant for us."""
        if self.public is not None:
            return host.lower() == urlsplit(self.public).netloc and origin in (None, self.public)
        if self.scheme == "http" and _without_port(host) not in _LOCAL:
            return False
        return origin in (None, f"{self.scheme}://{host}")

    def refusal(self, host: str) -> str:
        """Why a request that is not ours is refused; a proxy that asks by another name than it was asked is told."""
        if self.public is not None and host.lower() != urlsplit(self.public).netloc:
            return f"this gateway is opened as {self.public}; a proxy has to pass on the Host that it was asked for"
        return "this gateway is not meant by this address, or asked from another page"


def _without_port(host: str) -> str:
    name, separator, port = host.rpartition(":")
    return name if separator and port.isdigit() else host


class Guard:
    """Around the whole application."""

    def __init__(self, app: ASGIApp, origins: Origins, most: int = MOST_CONNECTIONS) -> None:
        self._app, self._origins, self._most = app, origins, most
        self.connections = 0
        self.refused = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request or connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if not self._origins.is_ours(headers.get("host", ""), headers.get("origin")):
            await self._refuse(scope, receive, send, 403, self._origins.refusal(headers.get("host", "")))
        elif self.connections >= self._most + (_FOR_ORDERS if scope["path"] == ORDERS_PATH else 0):
            await self._refuse(
                scope, receive, send, 503, f"{self._most} connections are open already; close one of them"
            )
        else:
            self.connections += 1
            try:
                await self._app(scope, receive, _with_headers(send))
            finally:
                self.connections -= 1

    async def _refuse(self, scope: Scope, receive: Receive, send: Send, status: int, why: str) -> None:
        self.refused += 1
        if scope["type"] == "websocket" and "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008, "reason": why})
        else:
            await PlainTextResponse(f"{why}\n", status)(scope, receive, _with_headers(send))


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"].endswith("http.response.start"):
            given = list(message.get("headers", []))
            message = {**message, "headers": given + [pair for pair in _HEADERS if pair[0] not in dict(given)]}
        await send(message)

    return sent
