"""The driver `canbus` where SocketCAN is in trouble: down, gone, overrun, in error: run by the campaign ``vm``."""

from contextlib import contextmanager

import pytest

from micromanip.bus.errors import LinkError, TransientError
from micromanip.bus.inbox import Inbox

from .can_driver import FD, at_rest, driver, patiently, seen_empty, sensors, taken
from .machine import ok
from .vcan import CHANNEL, Dump, error_frame, set_link

pytestmark = pytest.mark.usefixtures("nobody")


@contextmanager
def small_receive_buffers():
    """For the sockets that are made meanwhile."""
    usual = ok("sysctl", "-n", "net.core.rmem_default").strip()
    ok("sysctl", "-w", "net.core.rmem_default=4096")
    try:
        yield
    finally:
        ok("sysctl", "-w", f"net.core.rmem_default={usual}")


def test_frames_that_did_not_fit_are_counted(opened):
    with small_receive_buffers():
        bus = opened(driver(**FD))
    count = 500
    ok("cangen", CHANNEL, "-g", "0", "-n", str(count), "-I", "101", "-f", "-b", "-L", "24", "-D", "r")
    seen_empty(bus)
    kept = bus.statistics()["frames_in"]
    assert 0 < kept < count
    ok("cansend", CHANNEL, sensors(1)[0])  # the kernel tells with the next frame that it takes
    seen_empty(bus)
    assert bus.statistics()["frames_in"] == kept + 1
    assert bus.statistics()["overflows"] == count - kept


def test_error_frames_are_counted_by_what_they_say(opened):
    bus = opened(driver(**FD))
    errors = [
        error_frame(0x004, 0x04),  # receive errors reached the warning level
        error_frame(0x004, 0x20),  # error-passive, for transmit errors
        error_frame(0x004, 0x01),  # the controller's own receive buffer overflowed
        error_frame(0x020),  # nobody acknowledged a frame
        error_frame(0x100),  # it was restarted
    ]
    with Dump(len(errors), errors=True) as dump:
        for error in errors:
            ok("cansend", CHANNEL, error)
        assert dump.frames() == errors
    ok("cansend", CHANNEL, sensors(1)[0])
    assert len(taken(bus)) == len(bus.inputs)
    counts = bus.statistics()
    assert {name: counts[name] for name in counts if name.startswith("error_")} == {
        "error_frames": 5,
        "error_warning": 1,
        "error_passive": 1,
    }
    assert (counts["overflows"], counts["unacknowledged"], counts["bus_off"], counts["frames_in"]) == (1, 1, 0, 1)


def test_bus_off_is_a_lost_link_and_comes_back(opened):
    bus = opened(driver(**FD))
    ok("cansend", CHANNEL, error_frame(0x040))
    with pytest.raises(LinkError, match=r"^bus-off on socketcan-vcan0: too many errors, "):
        bus.receive(Inbox(), patiently())
    bus.close()
    bus.open()
    ok("cansend", CHANNEL, sensors(1)[0])
    assert len(taken(bus)) == len(bus.inputs)
    assert bus.statistics()["bus_off"] == 1


def test_interface_that_goes_down_is_a_lost_link_and_comes_back(opened):
    bus = opened(driver(**FD))
    set_link("down")
    with pytest.raises(LinkError, match=r"^socketcan-vcan0, receiving: Network is down$"):
        bus.receive(Inbox(), patiently())
    with pytest.raises(LinkError, match=r"^socketcan-vcan0, sending: .*Network is down"):
        bus.perform(0, at_rest(bus), Inbox())
    bus.close()
    with pytest.raises(LinkError, match=r"^socketcan-vcan0: vcan0 is down; as root: ip link set vcan0 up "):
        bus.open()
    set_link("up")
    bus.open()
    with Dump(1) as dump:
        bus.perform(0, at_rest(bus), Inbox())
        assert [frame[:6] for frame in dump.frames()] == ["100##1"]
    ok("cansend", CHANNEL, sensors(1)[0])
    assert len(taken(bus)) == len(bus.inputs)


def test_full_transmit_queue_is_told_and_leaves_no_gap_in_the_count(opened):
    bus = opened(driver(**FD))
    ok("tc", "qdisc", "add", "dev", CHANNEL, "root", "netem", "delay", "200s", "limit", "3")
    try:
        for _ in range(3):
            bus.perform(0, at_rest(bus), Inbox())
        for _ in range(2):
            with pytest.raises(TransientError, match=r"No buffer space available .*\(transmit buffer full\)$"):
                bus.perform(0, at_rest(bus), Inbox())
    finally:
        ok("tc", "qdisc", "delete", "dev", CHANNEL, "root")
    assert bus.statistics()["transmit_full"] == 2
    with Dump(1) as dump:
        bus.perform(0, at_rest(bus), Inbox())
        assert [frame[-2:] for frame in dump.frames()] == ["03"]
