"""Clients as they should not be, on a real port: too many, vanished, deaf; the others go on."""

import asyncio
import contextlib
import json
import socket

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from micromanip.cli.main import main
from micromanip.gateway import app, impatient
from micromanip.gateway.app import Gateway
from micromanip.gateway.frames import parsed
from micromanip.gateway.guard import MOST_CONNECTIONS, Origins
from micromanip.gateway.tokens import Token, Tokens

from .rings import Played, rows, status
from .served import follow, served

pytestmark = pytest.mark.live
SEE = "s" * 24
HELLO = json.dumps({"type": "hello", "token": SEE})
VIEW = json.dumps({"type": "view", "fields": ["x.strain_um"], "span_s": 0.5, "points": 400, "last": None})
DRAWN = '{"type": "drawn"}'
PATIENCE_S = 60.0


class Open:
    """What a test sees of a gateway, from outside and inside."""

    def __init__(self, folder):
        self.played = Played(folder / "control.sock")
        self.played.cell.status, self.played.cell.problem = status(), None
        follow(self.played)
        self.played.play(rows(np.arange(5000)))
        self.gateway = Gateway(self.played.cell, Tokens([Token("screen", "observe", SEE)]), Origins(), lambda: None)
        self.address = None

    @contextlib.asynccontextmanager
    async def browser(self, **how):
        async with connect(
            f"{self.address.replace('http', 'ws')}/live", max_size=None, open_timeout=PATIENCE_S, **how
        ) as made:
            await made.send(HELLO)
            assert json.loads(await made.recv())["type"] == "hello"
            yield made

    async def is_left(self, connections):
        """Until so many connections are there, and as many listen to the cell."""
        async with asyncio.timeout(PATIENCE_S):
            while (self.gateway.guard.connections, len(self.played.cell.listeners)) != (connections, connections):
                await asyncio.sleep(0.02)


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    made = Open(tmp_path_factory.mktemp("abuse"))
    with served(made.gateway) as made.address:
        yield made


async def frames(browser, wanted):
    """So many traces, as a browser that draws them takes them: their newest cycles."""
    found = []
    while len(found) < wanted:
        message = await browser.recv()
        await browser.send(DRAWN)
        if isinstance(message, bytes):
            found.append(parsed(message)[0]["newest"])
    return found


def test_two_hundred_come_in_and_the_next_is_told(opened):
    async def do():
        async with contextlib.AsyncExitStack() as stack, asyncio.timeout(4 * PATIENCE_S):
            for _ in range(MOST_CONNECTIONS):
                await stack.enter_async_context(opened.browser())
            with pytest.raises(InvalidStatus) as refused:
                await stack.enter_async_context(opened.browser())
            assert refused.value.response.status_code == 503
            assert b"200 connections are open already" in refused.value.response.body
        await opened.is_left(0)
        async with opened.browser():
            await opened.is_left(1)

    asyncio.run(do())


def request(opened, path, body=b"{}", length=None):
    """A connection that has sent this much of a request of the observer."""
    made = socket.create_connection(opened.address.removeprefix("http://").split(":"))
    made.settimeout(PATIENCE_S)
    made.sendall(
        f"POST {path} HTTP/1.1\r\nHost: {opened.address[7:]}\r\nAuthorization: Bearer {SEE}\r\nContent-Type: "
        f"application/json\r\nContent-Length: {len(body) if length is None else length}\r\n\r\n".encode()
    )
    made.sendall(body)
    return made


def test_connections_that_ask_for_nothing_make_room_and_end(opened, monkeypatch):
    monkeypatch.setattr(impatient, "MOST_SOCKETS", 20)
    with contextlib.ExitStack() as stack:
        half = [stack.enter_context(socket.create_connection(opened.address[7:].split(":"))) for _ in range(30)]
        for each in half:
            each.settimeout(PATIENCE_S)
        assert half[0].recv(1) == b"", "the oldest made room"
        with request(opened, "/api/order") as asked:
            assert asked.recv(100).startswith(b"HTTP/1.1 403")
        half[-1].sendall(b"POST /api/order HTTP/1.1\r\n")
        assert half[-1].recv(1) == b"", "nor does it wait for ever"


def test_a_body_that_does_not_come_is_not_waited_for(opened, monkeypatch):
    monkeypatch.setattr(app, "_BODY_S", 0.2)
    with request(opened, "/api/recording", b"{", 100) as asked:
        assert b"the body was not whole" in b"".join(iter(lambda: asked.recv(4096), b""))


def test_orders_come_in_where_all_else_is_taken(opened, monkeypatch):
    monkeypatch.setattr(opened.gateway.guard, "_most", 0)
    for path, status_code in (("/api/status", b"503"), ("/api/order", b"403")):
        with request(opened, path) as asked:
            assert asked.recv(100).split()[1] == status_code


def test_browsers_that_vanish_leave_nothing_behind(opened):
    async def do():
        for _ in range(5):
            async with opened.browser() as made:
                await made.send(VIEW)
                made.transport.abort()
                await made.wait_closed()
        with socket.create_connection(opened.address.removeprefix("http://").split(":")) as half:
            half.sendall(b"GET /live HTTP/1.1\r\nHost: ")
        await opened.is_left(0)

    asyncio.run(do())


def test_one_that_reads_nothing_holds_nobody_up(opened):
    async def do():
        async with opened.browser(max_queue=1) as deaf, opened.browser() as other, asyncio.timeout(PATIENCE_S):
            for browser in (deaf, other):
                await browser.send(VIEW)
            first = await frames(other, 1)
            for k in range(10):
                opened.played.play(rows(np.arange(5000 + 500 * k, 5500 + 500 * k)))
                newest = await frames(other, 1)
                while newest[-1] < 5499 + 500 * k:
                    newest = await frames(other, 1)
            assert newest[-1] == 9999 > first[-1]
            waiting = 0
            with contextlib.suppress(TimeoutError):
                while True:  # what was sent before it was told that something was drawn
                    await asyncio.wait_for(deaf.recv(), 1.0)
                    waiting += 1
            assert waiting <= 3, "two traces, and a status"
        await opened.is_left(0)

    asyncio.run(do())


def test_a_port_that_is_in_use_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("os.umask", lambda _: 0)  # it would be that of the tests after this one, too
    config = tmp_path / "cell.yaml"
    config.write_text("")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        place = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(SystemExit) as ended:
            main(["gateway", str(config), "--listen", place, "--tokens", str(tmp_path / "tokens")])
    assert ended.value.code == 69
    assert f"--listen {place}: Address already in use; choose another" in capsys.readouterr().err
