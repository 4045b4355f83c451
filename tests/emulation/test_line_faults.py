"""Faults of a line, on a port that notes what passes."""

import pytest
from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.line.device_line import DeviceLine
from micromanip.emulation.line.faults import parsed
from micromanip.emulation.line.port import LineFigures
from micromanip.emulation.line.udp_port import UdpPort
from micromanip.errors import UsageError

from .lines import free_port


class NotedPort:
    """Notes what is sent, and when it was; what arrives is said by `hear`."""

    name = "noted"
    echo = False

    def __init__(self, loop, hear):
        self.figures, self.hear = LineFigures(), hear
        self._loop = loop
        self.sent, self.calls = [], []

    def send(self, data):
        self.sent.append((self._loop.time_ns, data))

    def unplug(self):
        self.calls.append("unplug")

    def plug_in(self):
        self.calls.append("plug_in")

    def close(self):
        self.calls.append("close")


class Line:
    """A line with a device that notes what it hears."""

    def __init__(self):
        self.loop = VirtualLoop()
        self.line = DeviceLine(self.loop, lambda hear: NotedPort(self.loop, hear), seed=3)
        self.port, self.heard = self.line.port, []
        self.line.attach(lambda data, peer: self.heard.append(data))

    def inject(self, kind, **about):
        self.line.inject(parsed({"kind": kind, **about}))

    def run(self, seconds):
        self.loop.run(self.loop.time_ns + round(seconds * 1e9))

    def sends(self, *messages):
        """What goes out of the port for these messages, a millisecond apart."""
        for message in messages:
            self.line.send(message)
            self.run(0.001)
        self.run(1.0)
        sent, self.port.sent = [data for _, data in self.port.sent], []
        return sent


@pytest.fixture
def line():
    line = Line()
    yield line
    line.loop.close()


MESSAGES = (b"first", b"second", b"third", b"fourth")


def test_drop(line):
    line.inject("drop")
    assert line.sends(*MESSAGES) == []
    line.line.clear()
    assert line.sends(*MESSAGES) == list(MESSAGES)


def test_a_late_reply_comes_behind_the_fault_too(line):
    """The fault is over, but what it held up is still on its way: the next message waits for it."""
    line.inject("delay", ms=100, for_s=0.01)
    assert line.sends(b"late") == [b"late"]
    line.inject("delay", ms=100, for_s=0.01)
    line.line.send(b"late")
    line.run(0.02)
    line.line.send(b"next")
    assert line.port.sent == []
    line.run(0.2)
    assert [data for _, data in line.port.sent] == [b"late", b"next"]


def test_duplicate_and_reorder(line):
    line.inject("duplicate")
    assert line.sends(b"a", b"b") == [b"a", b"a", b"b", b"b"]
    line.line.clear()
    line.inject("reorder")
    assert line.sends(*MESSAGES) == [b"second", b"first", b"fourth", b"third"]


def test_split_and_join(line):
    line.inject("split", gap_ms=5)
    began_ns = line.loop.time_ns
    parts = [(line.line.send(b"0123456789"), line.run(0.1)) and line.port.sent][0]
    assert b"".join(data for _, data in parts) == b"0123456789"
    assert [time_ns - began_ns for time_ns, _ in parts] == [0, 5_000_000]
    line.port.sent = []
    line.line.clear()
    line.inject("join", count=3)
    assert line.sends(*MESSAGES) == [b"firstsecondthird"]
    line.line.clear()
    assert line.port.sent[0][1] == b"fourth"


def test_garbage_flip_and_short(line):
    line.inject("garbage", count=8)
    (spoiled,) = line.sends(b"message")
    assert len(spoiled) == 8 + len(b"message")
    assert spoiled.endswith(b"message")
    line.line.clear()
    line.inject("flip", bits=2)
    (spoiled,) = line.sends(b"message")
    assert sum((a ^ b).bit_count() for a, b in zip(spoiled, b"message", strict=True)) == 2
    line.line.clear()
    line.inject("short")
    for spoiled in line.sends(*[b"message"] * 20):
        assert b"message".startswith(spoiled)
        assert len(spoiled) < len(b"message")


def test_hang(line):
    line.inject("hang", for_s=0.1)
    line.port.hear(b"question", line.port)
    line.line.send(b"answer")
    assert (line.heard, line.port.sent) == ([], [])
    line.run(0.11)
    line.port.hear(b"question", line.port)
    assert line.heard == [b"question"], "what was asked meanwhile is lost"


def test_unplug_echo_and_back(line):
    line.inject("unplug", for_s=0.1)
    line.inject("echo", for_s=0.2)
    assert line.port.echo
    line.run(0.3)
    assert line.port.calls == ["unplug", "plug_in"]
    assert not line.port.echo


def test_the_same_seed_is_the_same_fault():
    outcomes = []
    for _ in range(2):
        line = Line()
        line.inject("flip", share=0.5)
        outcomes.append(line.sends(*[b"message"] * 20))
        line.loop.close()
    assert outcomes[0] == outcomes[1]
    assert len(set(outcomes[0])) > 5


def test_a_stranger_needs_datagrams(line):
    for kind in ("stranger", "disconnect"):
        with pytest.raises(UsageError, match=f"fault {kind}: .*noted"):
            line.inject(kind)
    port = free_port()
    udp = DeviceLine(line.loop, lambda hear: UdpPort(line.loop, "127.0.0.1", port, None, hear, 1e8))
    udp.inject(parsed({"kind": "stranger"}))
    udp.close()
