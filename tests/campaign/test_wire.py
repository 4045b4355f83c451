"""The wire passes on what comes, and each kind of cut is what it is called."""

import socket
import threading
import time
from contextlib import suppress

import pytest

from campaigns.taps import Arrivals, GcsTap
from campaigns.wire import Wire


class Answering:
    """A device that answers every line with `0`, and keeps what came."""

    def __init__(self):
        self.heard = b""
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self):
        with suppress(OSError):
            while True:
                link, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(link,), daemon=True).start()

    def _serve(self, link):
        with link, suppress(OSError):
            while data := link.recv(1000):
                self.heard += data
                link.sendall(b"0\n" * data.count(b"\n"))

    def close(self):
        self._listener.close()


@pytest.fixture
def device():
    played = Answering()
    yield played
    played.close()


@pytest.fixture
def wire(device):
    arrivals = Arrivals()
    line = Wire(device.port, lambda: GcsTap(arrivals, {"1": "x"}))
    line.arrivals = arrivals
    yield line
    line.close()


@pytest.fixture
def controller(wire):
    with socket.create_connection(("127.0.0.1", wire.place)) as link:
        link.settimeout(0.5)
        assert asked(link, b"ERR?\n") == b"0\n"
        yield link


def asked(link, line):
    """What comes back; None for nothing, empty where the connection has ended."""
    try:
        link.sendall(line)
        return link.recv(1000)
    except TimeoutError:
        return None
    except OSError:
        return b""


def comes(device, line):
    """Whether the device hears it, before long."""
    end = time.monotonic() + 5.0
    while line not in device.heard and time.monotonic() < end:
        time.sleep(0.01)
    return line in device.heard


def test_passes_on(wire, device, controller):
    assert asked(controller, b"SVA 1 5\n") == b"0\n"
    assert wire.arrivals.volts() == {"x": 5.0}


def test_hole(wire, device, controller):
    wire.cut("hole")
    assert asked(controller, b"SVA 1 5\n") is None
    wire.mend()
    assert asked(controller, b"SVA 1 6\n") == b"0\n"
    assert b"SVA 1 5" not in device.heard
    assert [each.volts for each in wire.arrivals.copy()] == [6.0]


def test_late(wire, device, controller):
    wire.cut("late")
    assert asked(controller, b"SVA 1 5\n") is None
    controller.close()
    assert wire.arrivals.copy() == []
    wire.mend()
    assert comes(device, b"SVA 1 5\n")
    assert wire.arrivals.volts() == {"x": 5.0}


def test_deaf(wire, device, controller):
    wire.cut("deaf")
    assert asked(controller, b"SVA 1 5\n") is None
    assert comes(device, b"SVA 1 5\n")
    assert wire.arrivals.volts() == {"x": 5.0}


def test_reset_and_refused(wire, device, controller):
    wire.cut("reset")
    assert asked(controller, b"SVA 1 5\n") == b""
    with socket.create_connection(("127.0.0.1", wire.place)) as again:
        assert asked(again, b"SVA 1 6\n") == b"0\n"
        wire.cut("refused")
        assert asked(again, b"SVA 1 7\n") == b""
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", wire.place))
    wire.mend()
    with socket.create_connection(("127.0.0.1", wire.place)) as again:
        assert asked(again, b"SVA 1 8\n") == b"0\n"
    assert [each.volts for each in wire.arrivals.copy()] == [6.0, 8.0]


def test_a_refused_port_is_nobody_elses(wire):
    """Once another process of the machine had been given it meanwhile, and the line never came back."""
    wire.cut("refused")
    with socket.socket() as other, pytest.raises(OSError, match="in use"):
        other.bind(("127.0.0.1", wire.place))
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", wire.place))
