"""The link on python-can's `virtual` bus, and its errors on a bus that fails as told."""

import errno
import time

import can
import pytest
from micromanip_drivers.canbus.link import CanLink, LinkOptions

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


@pytest.mark.parametrize(
    ("interface", "channel", "words"),
    [
        ("socketcan", "can99", "socketcan-can99: there is no network interface can99"),
        ("micromanip", "no-such-hub", "micromanip-no-such-hub can't be opened: no hub for channel no-such-hub"),
        ("pcan", "PCAN_USBBUS1", "pcan-PCAN_USBBUS1 can't be opened: .*library not found"),
    ],
)
def test_an_interface_that_is_not_there(interface, channel, words):
    with pytest.raises(LinkError, match=words):
        CanLink(options(interface, channel)).open_fully()


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
    link = failing(monkeypatch, can.CanOperationError("hiccup", errno.ENETDOWN), interface="virtual")
    with pytest.raises(TransientError, match="hiccup"):
        link.receive(0)
