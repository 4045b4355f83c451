"""The gateway before a made-up ring: who is let in, what is shown, and what a slow browser gets."""

import asyncio
import json

import numpy as np
import pytest

from micromanip.gateway.app import PATHS, Gateway
from micromanip.gateway.frames import parsed
from micromanip.gateway.guard import Origins
from micromanip.gateway.tokens import Token, Tokens
from tests.cli.played import FAULT
from tests.cli.played import Played as PlayedSocket

from .asgi import HOST, Browser, request
from .rings import Played, rows, status

SEE, DO = "s" * 24, "d" * 24
VIEW = {"type": "view", "fields": ["x.strain_um"], "span_s": 0.1, "points": 2000, "last": None}


@pytest.fixture
def played(tmp_path):
    made = Played(tmp_path / "control.sock")
    made.cell.status, made.cell.problem = status(), None
    return made


@pytest.fixture
def app(played):
    tokens = Tokens([Token("screen", "observe", SEE), Token("ana", "operate", DO)])
    return Gateway(played.cell, tokens, Origins(), lambda: None).guard


def ask(app, path, **how):
    return asyncio.run(request(app, path, **how))


def frame(message):
    return isinstance(message, bytes) and parsed(message)[0]["type"] == "frame"


def kind(name):
    return lambda message: isinstance(message, dict) and message["type"] == name


async def greeted(app, played, *messages):
    browser = Browser(app)
    browser.say({"type": "hello", "token": SEE})
    await browser.heard(kind("hello"))
    await browser.heard(kind("status"))
    browser.say({"type": "drawn"})
    for message in messages:
        browser.say(message)
    return browser


@pytest.mark.parametrize("path", [*PATHS.values(), "/static/scope.js", "/static/third_party/uplot/uPlot.esm.js"])
def test_pages_load_nothing_from_elsewhere(app, path):
    code, headers, body = ask(app, path)
    assert code == 200
    assert headers["content-security-policy"].startswith("default-src 'self';")
    assert headers["x-frame-options"] == "DENY"
    assert b"<script>" not in body
    assert b"style=" not in body or path.endswith(".js")


@pytest.mark.parametrize(
    ("path", "method", "body"),
    [("/api/status", "GET", None), ("/metrics", "GET", None), ("/api/order", "POST", {"order": "arm"})],
)
def test_without_a_right_token_nothing_is_told(app, path, method, body):
    assert ask(app, path, method=method, body=body)[0] == 401
    code, _, text = ask(app, path, method=method, body=body, token="w" * 24)
    assert code == 403
    assert b"token is not known here" in text
    code, _, text = ask(app, f"{path}?token={DO}", method=method, body=body)
    assert code == 401
    assert b"One in an address is not taken" in text
    if method == "GET":
        assert ask(app, path, token=SEE)[0] == 200


def test_the_wrong_token_closes_the_live_connection(app):
    async def play():
        for hello in ({"type": "hello", "token": "w" * 24}, {"type": "hello"}, [1], "{"):
            browser = Browser(app)
            browser.say(hello)
            assert await browser.ended() == 1008
            assert browser.told == []

    asyncio.run(play())


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        (HOST, "http://evil.example"),
        (HOST, "null"),
        ("evil.example:8090", "http://evil.example:8090"),  # DNS rebinding
        ("evil.example", None),
        (HOST, f"https://{HOST}"),
    ],
)
def test_foreign_pages_and_names_are_refused(app, host, origin):
    assert ask(app, "/api/order", method="POST", body={"order": "disarm"}, token=DO, host=host, origin=origin)[0] == 403

    async def play():
        browser = Browser(app, host=host, origin=origin)
        assert await browser.ended() == 1008

    asyncio.run(play())
    assert app.refused == 2


def test_behind_a_proxy_and_with_tls_other_names_are_ours():
    assert Origins(public="https://cell.example").is_ours("cell.example", "https://cell.example")
    assert not Origins(public="https://cell.example").is_ours(HOST, f"http://{HOST}")
    assert Origins("https").is_ours("cell:8443", "https://cell:8443")
    assert not Origins("https").is_ours("cell:8443", "http://cell:8443")
    assert Origins().is_ours("[::1]:8090", "http://[::1]:8090")
    assert not Origins().is_ours("localhost.evil.example:80", None)


def test_orders_go_to_the_control_socket_in_the_name_of_the_token(tmp_path, played, app):
    heard = []

    class Listening(PlayedSocket):
        def _serve(self, connection):
            with connection.makefile("rb") as lines:
                for line in lines:
                    heard.append(json.loads(line))
                    connection.sendall(json.dumps(self._answer(heard[-1]["verb"])).encode() + b"\n")

    code, _, text = ask(app, "/api/order", method="POST", body={"order": "arm"}, token=DO)
    assert (code, b"no controller answers" in text) == (503, True)
    controller = Listening(played.cell.socket)
    try:
        assert ask(app, "/api/order", method="POST", body={"order": "arm"}, token=DO)[0] == 200
        assert heard == [{"version": 1, "verb": "arm", "on_behalf_of": "ana"}]
        assert ask(app, "/api/order", method="POST", body={"order": "arm"}, token=SEE)[0] == 403
        assert ask(app, "/api/order", method="POST", body={"order": "set"}, token=DO)[0] == 400
        assert ask(app, "/api/order", method="POST", body=b"[" * 5000, token=DO)[0] == 400
        assert len(heard) == 1
        controller.refuses = "arm refused: the state is FAULT"
        code, _, text = ask(app, "/api/order", method="POST", body={"order": "arm"}, token=DO)
        assert (code, json.loads(text)["error"]) == (409, "arm refused: the state is FAULT")
    finally:
        controller.close()


def test_what_is_played_is_seen_without_gaps(app, played):
    async def play():
        browser = await greeted(app, played, VIEW)
        seen = []
        for begin in range(0, 3000, 500):
            played.play(rows(np.arange(begin, begin + 500), x_strain_um=np.arange(begin, begin + 500)))
            before = len(browser.told)
            played.read()
            await browser.heard(lambda m, b=before: frame(m) and parsed(m)[0]["newest"] == begin + 499)  # noqa: B023
            browser.say({"type": "drawn"})
            header, arrays = parsed([m for m in browser.told[before:] if frame(m)][-1])
            assert (header["rows"], header["missing"], header["lost"]) == (1, 0, 0)
            seen += (arrays["cycles"] + header["origin"]).tolist()
            np.testing.assert_array_equal(arrays["x.strain_um low"], arrays["cycles"] + header["origin"])
        assert sorted(set(seen)) == list(range(3000))
        await browser.leave()

    asyncio.run(play())


def test_a_frozen_browser_is_sent_two_messages_and_then_what_is_newest(app, played):
    async def play():
        browser = await greeted(app, played, VIEW)
        before = len(browser.told)
        for begin in range(0, 20_000, 200):
            played.play(rows(np.arange(begin, begin + 200)))
            played.read()
            await asyncio.sleep(0.002)
        assert len(browser.told) - before <= 2
        browser.say({"type": "drawn"})
        newest = await browser.heard(lambda m: frame(m) and parsed(m)[0]["newest"] == 19_999)
        assert parsed(newest)[0]["last"] == 19_999
        await browser.leave()
        assert app.connections == 0
        assert played.cell.listeners == set()

    asyncio.run(play())


def test_a_trigger_shows_its_cycle_and_what_was_before(app, played):
    trigger = {"mode": "single", "kind": "edge", "field": "x.strain_um", "level": 0.5, "slope": "up", "before": 0.25}

    async def play():
        browser = await greeted(app, played, VIEW, {"type": "trigger", "trigger": trigger})
        await asyncio.sleep(0.05)
        cycles = np.arange(6000)
        for part in np.split(rows(cycles, x_strain_um=(cycles % 2000) >= 1234), 60):
            played.play(part)
            played.read()
            await asyncio.sleep(0)
        header, arrays = parsed(await browser.heard(lambda m: frame(m) and parsed(m)[0]["trigger_cycle"] is not None))
        assert header["trigger_cycle"] == 1234
        assert (header["first"], header["last"]) == (1234 - 250, 1234 + 750)
        strain = arrays["x.strain_um low"]
        assert strain[arrays["cycles"] + header["origin"] < 1234].max() == 0.0
        assert strain[arrays["cycles"] + header["origin"] == 1234] == 1.0
        await asyncio.sleep(0.2)
        assert sum(map(frame, browser.told)) == 1, "single stays with the first"
        await browser.leave()

    asyncio.run(play())


@pytest.mark.parametrize(
    "message",
    [
        "[]", "{", "x" * 100, {"type": "dance"}, {**VIEW, "fields": ["x.nothing"]}, {**VIEW, "fields": "x.strain_um"},
        {**VIEW, "span_s": 1e9}, {**VIEW, "span_s": None}, {**VIEW, "points": 1e7}, {**VIEW, "last": -1},
        {"type": "trigger", "trigger": {"kind": "edge"}}, {"type": "spectrum", "fields": ["x.strain_um"]},
        {"type": "xy", "fields": ["x.strain_um"], "first": 0, "last": 9}, {"type": "trigger", "trigger": 7},
    ],
)  # fmt: skip
def test_messages_that_make_no_sense_are_told_and_survived(app, played, message):
    played.play(rows(np.arange(100)))
    played.read()

    async def play():
        browser = await greeted(app, played, message)
        assert (await browser.heard(kind("problem")))["problem"]
        browser.say({"type": "drawn"})
        browser.say(VIEW)
        await browser.heard(frame)
        browser.say("y" * 20_000)
        assert await browser.ended() == 1003
        await browser.leave()

    asyncio.run(play())


def test_a_fault_does_not_wait_until_traces_are_drawn(app, played):
    view = {"type": "view", "fields": ["x.strain_um"], "span_s": 1.0, "points": 100, "last": None}

    async def play():
        browser = await greeted(app, played, view)
        for first in (0, 100):  # two traces that it does not say are drawn
            played.play(rows(np.arange(first, first + 100)))
            played.read()
            await browser.heard(lambda m, newest=first + 99: frame(m) and parsed(m)[0]["newest"] == newest)
        played.play(rows(np.arange(200, 300)))
        played.read()
        played.cell.status = status("FAULT", [FAULT])
        played.cell._notify(None)
        await browser.heard(lambda m: kind("status")(m) and m["status"]["state"] == "FAULT")
        before = len(browser.told)
        played.cell._notify(None)
        await asyncio.sleep(0.2)
        assert len(browser.told) == before, "it is not overwhelmed either"
        browser.say({"type": "drawn"})
        await browser.heard(kind("status"))
        await browser.leave()

    asyncio.run(play())


def test_the_fault_of_a_controller_that_is_gone_stays_until_somebody_has_seen_it(app, played):
    """It comes up again at once, as a service does, and its fault would be gone with it."""
    cell = played.cell
    cell.take(status("FAULT", [FAULT]))
    assert cell.unseen is None, "the status has it"
    cell.take(None)
    cell.source.inode = 2  # the memory of the next controller
    cell.take(status("READY"))
    assert cell.unseen == {"fault_reports": [FAULT], "trips": []}
    assert ask(app, "/api/seen", method="POST", body={}, token=SEE)[0] == 403, "a screen on the wall has seen nothing"
    assert cell.unseen
    assert ask(app, "/api/seen", method="POST", body={}, token=DO)[0] == 200
    assert cell.unseen is None


def test_a_fault_that_was_reset_is_not_shown_once_more(played):
    for told in (status("FAULT", [FAULT]), status("READY"), None, status("READY")):
        played.cell.take(told)
    assert played.cell.unseen is None


def test_a_form_of_another_page_orders_nothing(app):
    code, _, text = ask(app, "/api/order", method="POST", body={"order": "arm"}, token=DO, content="text/plain")
    assert (code, b"application/json" in text) == (400, True)


def test_spectrum_and_xy_are_of_what_is_seen(app, played):
    t = np.arange(20_000) / 1e4
    sine = 3.0 * np.sin(2 * np.pi * 66.0 * t)
    played.play(rows(np.arange(20_000), x_strain_um=sine, x_voltage_V=2.0 * sine))
    played.read()

    async def play():
        window = {"first": 0, "last": 19_999}
        browser = await greeted(app, played, {"type": "spectrum", "fields": ["x.strain_um"], **window})
        of = lambda name: lambda m: isinstance(m, bytes) and parsed(m)[0]["type"] == name  # noqa: E731
        header, arrays = parsed(await browser.heard(of("spectrum")))
        frequency, amplitude = header["lines"]["x.strain_um"][0]
        assert frequency == pytest.approx(66.0, rel=0.01)
        assert amplitude == pytest.approx(3.0, rel=0.01)
        assert len(arrays["x.strain_um"]) == len(arrays["frequency_Hz"])
        browser.say({"type": "drawn"})
        browser.say({"type": "xy", "fields": ["x.strain_um", "x.voltage_V"], **window})
        _, arrays = parsed(await browser.heard(of("xy")))
        np.testing.assert_allclose(arrays["y"], 2.0 * arrays["x"], rtol=1e-6)
        await browser.leave()

    asyncio.run(play())
