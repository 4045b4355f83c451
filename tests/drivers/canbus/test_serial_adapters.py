"""Adapters that python-can serves through a serial port: each sample that there is, and nobody waits for one."""

import threading
import time

import can
import pytest
from micromanip_drivers.canbus.driver import CanBus

from micromanip.bus.beginning import opened
from micromanip.bus.errors import LinkError, StillOpening, TransientError
from micromanip.bus.inbox import Inbox

from .serial_adapter import DBC, SerialAdapter, seeedstudio, slcan

pytestmark = pytest.mark.realtime  # an adapter in a thread, whose port takes so many bytes

RATE_HZ = 200
KINDS = {"slcan": (slcan, {"sleep_after_open": 0.0}), "seeedstudio": (seeedstudio, {"timeout": 0.01})}


def driver(folder, interface, silence_ms=500, **options):
    (folder / "node.dbc").write_text(DBC, encoding="utf-8")
    if interface not in KINDS:  # of a library that is played nothing but its port is there
        (folder / "tty").touch()
    return CanBus(
        CanBus.Options.model_validate(
            {
                "interface": interface,
                "channel": str(folder / "tty"),
                "bitrate": 500_000,
                "interface_options": {**KINDS.get(interface, (None, {}))[1], **options},
                "database": "node.dbc",
                "silence_ms": silence_ms,
                "receive": {"Gauge": {"rate_hz": RATE_HZ, "counter": "Count"}},
                "send": {"Command": {"rate_hz": 50, "counter": "Count"}},
            }
        ),
        folder,
    )


def adapter(folder, interface, **keys):
    return SerialAdapter(folder / "tty", KINDS[interface][0], RATE_HZ, **keys)


def patient(problem, for_s):
    return for_s < 20.0


def served(bus, until, voltage=50.0):
    """Serve it as a worker does, voltages at 50 Hz; the samples that came, and the problems."""
    inbox, samples, problems = Inbox(), [], []
    due_ns, end_s = time.monotonic_ns(), time.monotonic() + 30.0
    while not until(samples):
        assert time.monotonic() < end_s, "it never came"
        try:
            if time.monotonic_ns() >= due_ns:
                due_ns += 20_000_000
                bus.perform(0, [voltage], inbox)
            else:
                bus.receive(inbox, due_ns)
        except TransientError as problem:
            if "transmit buffer full" not in str(problem):  # a computer that is busy with something else
                problems.append(str(problem))
        samples += inbox
        inbox.clear()
    return samples, problems


@pytest.mark.parametrize("interface", KINDS)
def test_each_sample_comes_and_each_voltage_goes(tmp_path, interface):
    bus = driver(tmp_path, interface, silence_ms=10_000)
    assert bus.steady() is None, "it has no socket for compiled turns"
    with adapter(tmp_path, interface) as device:
        assert opened(bus, patient)
        samples, problems = served(bus, lambda samples: len(samples) >= 2 * RATE_HZ)
        bus.close()
    assert not problems
    assert not sum(sample.lost for sample in samples)
    assert all(sample.value == pytest.approx(12.34) for sample in samples)
    frames = device.heard.count(b"t1004881300") + device.heard.count(b"\xaa\xc4\x00\x01\x88\x13\x00")
    assert frames == bus.statistics()["frames_out"] > 50


@pytest.mark.parametrize(
    ("interface", "spoil", "least", "most"),
    [
        ("slcan", lambda frame: [(0.0, frame[:7] + b"G" + frame[8:])], 7, 21),
        ("slcan", lambda frame: [(0.0, frame[:7] + b"\xff" + frame[8:])], 7, 21),
        ("slcan", lambda frame: [(0.0, frame[:6] + b"\r")], 7, 21),
        ("slcan", lambda frame: [(0.0, frame[:5]), (0.05, frame[5:])], 0, 0),
        ("seeedstudio", lambda frame: [(0.0, frame[:1]), (0.05, frame[1:])], 1, 21),  # on a busy computer in one piece
        ("seeedstudio", lambda frame: [(0.0, frame[:2]), (0.05, frame[2:])], 1, 21),
        ("seeedstudio", lambda frame: [(0.0, frame[:-1] + b"\x00")], 7, 21),
    ],
)
def test_a_bad_frame_is_one_frame(tmp_path, interface, spoil, least, most):
    said = lambda number, frame: [(0.0, frame)] if number % 50 else spoil(frame)  # noqa: E731
    bus = driver(tmp_path, interface, silence_ms=10_000)  # a test beside others is held up
    with adapter(tmp_path, interface, said=said) as device:
        assert opened(bus, patient)
        samples, problems = served(bus, lambda _: device.sent >= 380)
        bus.close()
    assert not problems
    # a good frame or two that follow at once may be read as the rest of the bad one
    assert least <= sum(sample.lost for sample in samples) <= most
    assert samples


def test_an_adapter_that_stops_reading_is_a_lost_link(tmp_path):
    bus = driver(tmp_path, "slcan")
    with adapter(tmp_path, "slcan") as device:
        assert opened(bus, patient)
        served(bus, lambda samples: len(samples) > 10)
        device.reads = False
        with pytest.raises(LinkError, match="does the adapter still read"):
            flooded(bus)
        bus.close()
        device.reads = True
        assert opened_again(bus)
        samples, problems = served(bus, lambda samples: len(samples) > 10)
        assert samples
        assert not problems
        bus.close()


def flooded(bus):
    """Send until that is a lost link."""
    inbox = Inbox()
    for _ in range(100_000):
        bus.receive(inbox, 0)
        try:
            bus.perform(0, [1.0], inbox)
        except TransientError:
            time.sleep(0.01)


def opened_again(bus, seconds=10.0):
    """Whether it opens, once the library has let go of what was before."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            return opened(bus, patient)
        except LinkError:
            bus.close()
            time.sleep(0.05)
    return False


class OddBus:
    """A library that does as it is told."""

    channel_info = "odd"

    def __init__(self, receive, send=lambda message: None):
        self.receive, self.said, self.ended = receive, send, 0

    def recv(self, timeout):
        time.sleep(0.002)
        return self.receive()

    def send(self, message, timeout):
        self.said(message)

    def shutdown(self):
        self.ended += 1


def gauge():
    return can.Message(arbitration_id=0x101, data=b"\xd2\4\0\1", is_extended_id=False)


def test_a_library_that_takes_its_time_to_open_holds_up_nobody(tmp_path, monkeypatch):
    odd = OddBus(gauge)

    def slow(*_, **__):
        time.sleep(1.0)
        return odd

    monkeypatch.setattr(can, "Bus", slow)
    bus = driver(tmp_path, "kvaser")
    with pytest.raises(StillOpening, match="the library has been opening it"):
        bus.open()
    assert opened(bus, patient)
    bus.close()
    assert odd.ended == 1


def test_a_library_that_raises_what_it_never_said_is_a_lost_link(tmp_path, monkeypatch):
    odd = OddBus(gauge)
    monkeypatch.setattr(can, "Bus", lambda *_, **__: odd)
    bus = driver(tmp_path, "kvaser")
    assert opened(bus, patient)

    def broken():
        raise IndexError("of its own making")

    odd.receive = broken
    with pytest.raises(LinkError, match="of its own making"):
        served(bus, lambda _: False)
    bus.close()
    monkeypatch.setattr(can, "Bus", lambda *_, **__: broken())
    with pytest.raises(LinkError, match="can't be opened: of its own making"):
        opened(bus, patient)
    bus.close()


def test_a_library_that_does_not_come_back_is_shut_down_and_opened_again(tmp_path, monkeypatch):
    shut = threading.Event()
    opened_buses = []

    def blocked():
        shut.wait()
        raise OSError("closed")

    def build(*_, **__):
        odd = OddBus(gauge)
        odd.shutdown = shut.set
        opened_buses.append(odd)
        return odd

    monkeypatch.setattr(can, "Bus", build)
    bus = driver(tmp_path, "kvaser")
    assert opened(bus, patient)
    opened_buses[0].receive = blocked
    with pytest.raises(LinkError, match="nothing of Gauge came"):
        served(bus, lambda _: False)
    bus.close()
    assert opened_again(bus)
    assert len(opened_buses) == 2
    bus.close()


def test_the_last_voltages_go_out_before_it_is_closed(tmp_path, monkeypatch):
    taken = []

    def slow(message):
        time.sleep(0.02)
        taken.append(message.data[:2])

    monkeypatch.setattr(can, "Bus", lambda *_, **__: OddBus(gauge, slow))
    bus = driver(tmp_path, "kvaser")
    assert opened(bus, patient)
    bus.perform(0, [50.0], Inbox())
    bus.perform(0, [0.0], Inbox())
    bus.close()
    assert taken == [b"\x88\x13", b"\x00\x00"]
