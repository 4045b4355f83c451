"""The link on python-can's `virtual` bus, and its errors on a bus that fails as told."""

import errno
import time

import can
import pytest
from micromanip_drivers.canbus.link import CanLink, LinkOptions
from pydantic import ValidationError

from micromanip.bus.errors import LinkError, TransientError

BITRATE = 1_000_000


def options(interface="virtual", channel="link", **keys):
    return LinkOptions(interface=interface, channel=channel, bitrate=BITRATE, **keys)


@pytest.fixture
def link():
    link = CanLink(options())
    link.open()
    yield link
    link.close()


@pytest.fixture
def peer():
    with can.Bus("link", "virtual") as bus:
        yield bus


def frame(identifier, data=b""):
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def later_ns(seconds):
    return time.monotonic_ns() + round(seconds * 1e9)


def test_what_is_there_comes_in_order_with_its_time(link, peer):
    before_ns = time.monotonic_ns()
    for k in range(5):
        peer.send(frame(k))
    received = link.receive(0)
    assert [message.arbitration_id for message, _ in received] == [0, 1, 2, 3, 4]
    assert all(before_ns <= time_ns <= time.monotonic_ns() for _, time_ns in received)


def test_it_waits_until_the_deadline_and_no_longer(link, peer):
    until_ns = later_ns(0.02)
    assert link.receive(until_ns) == []
    assert time.monotonic_ns() >= until_ns


def test_a_flood_is_taken_in_portions(link, peer):
    for _ in range(300):
        peer.send(frame(1))
    counts = [len(link.receive(0)) for _ in range(4)]
    assert sum(counts) == 300
    assert max(counts) < 300


def test_what_is_sent_arrives(link, peer):
    link.send(frame(0x7F, b"abc"))
    assert peer.recv(0).data == b"abc"
    assert link.statistics()["frames_out"] == 1


def test_error_frames_are_counted_and_kept_back(link, peer):
    peer.send(can.Message(is_error_frame=True, is_extended_id=False))
    peer.send(frame(3))
    assert [message.arbitration_id for message, _ in link.receive(0)] == [3]
    assert link.statistics()["error_frames"] == 1
    assert link.statistics()["frames_in"] == 1


def test_a_link_that_is_not_open_says_so():
    link = CanLink(options())
    link.close()
    for use in (lambda: link.send(frame(1)), lambda: link.receive(0)):
        with pytest.raises(LinkError, match="virtual-link is not open"):
            use()


@pytest.mark.parametrize(
    ("interface", "channel", "words"),
    [
        ("socketcan", "can99", "socketcan-can99: there is no network interface can99"),
        ("socketcan", "lo", "is not a CAN bus"),
        ("micromanip", "no-such-hub", "micromanip-no-such-hub can't be opened: no hub for channel no-such-hub"),
        ("pcan", "PCAN_USBBUS1", "pcan-PCAN_USBBUS1 can't be opened: .*library not found"),
        ("kvaser", 0, "is the library of kvaser installed"),
    ],
)
def test_an_interface_that_is_not_there(interface, channel, words):
    with pytest.raises(LinkError, match=words):
        CanLink(options(interface, channel)).open()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"interface": "socketcn"}, "did you mean socketcan"),
        ({"data_bitrate": 500_000}, "below bitrate"),
        ({"interface_options": {"fd": True}}, "fd is not set here"),
        ({"bitrat": 5}, "Extra inputs"),
    ],
)
def test_options_that_make_no_sense(keys, words):
    with pytest.raises(ValidationError, match=words):
        options(**keys)


class FailingBus:
    """Raises what it was given; everything else is left out."""

    channel_info = "failing"

    def __init__(self, error):
        self.error = error

    def send(self, message, timeout):
        raise self.error

    def recv(self, timeout):
        raise self.error

    def fileno(self):
        raise NotImplementedError

    def shutdown(self):
        raise RuntimeError("already gone")


def failing(monkeypatch, error, interface="micromanip"):
    monkeypatch.setattr(can, "Bus", lambda *_, **__: FailingBus(error))
    link = CanLink(options(interface))
    link.open()
    return link


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Failed to transmit: No buffer space available", errno.ENOBUFS),
        can.CanOperationError("Transmit buffer full"),
        OSError(errno.EAGAIN, "Resource temporarily unavailable"),
    ],
)
def test_a_full_transmit_buffer_passes(monkeypatch, error):
    link = failing(monkeypatch, error)
    with pytest.raises(TransientError, match=r"sending: .*transmit buffer full"):
        link.send(frame(1))
    assert link.statistics()["transmit_full"] == 1
    assert link.statistics()["frames_out"] == 0


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN),
        can.CanOperationError("Failed to receive: No such device", errno.ENODEV),
        OSError(errno.EIO, "Input/output error"),
        can.CanOperationError("the controller is in bus-off state"),
    ],
)
def test_a_bus_that_is_gone_is_a_lost_link(monkeypatch, error):
    link = failing(monkeypatch, error)
    with pytest.raises(LinkError, match="micromanip-link, sending"):
        link.send(frame(1))
    with pytest.raises(LinkError, match="micromanip-link, receiving"):
        link.receive(later_ns(0.01))
    link.close()
    link.close()


def test_a_code_of_a_vendor_is_not_taken_for_an_errno(monkeypatch):
    link = failing(monkeypatch, can.CanOperationError("hiccup", errno.ENETDOWN), interface="kvaser")
    with pytest.raises(TransientError, match="hiccup"):
        link.receive(0)
