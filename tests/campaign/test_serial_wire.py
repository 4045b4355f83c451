"""The same cuts on a serial line."""

import os
import time
import tty

import pytest
import serial

from campaigns.serial_wire import SerialWire
from campaigns.taps import Arrivals, GcsTap


class Ends:
    """The device's end of its port, and the wire in front of it."""

    def __init__(self, folder):
        self.device, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.device, False)
        self.arrivals = Arrivals()
        self.wire = SerialWire(os.ttyname(slave), 115200, folder / "front", lambda: GcsTap(self.arrivals, {"1": "x"}))
        os.close(slave)

    def controller(self):
        return serial.Serial(str(self.wire.place), 115200, timeout=0.3)

    def heard(self, most_s=2.0):
        """What the device hears, before long."""
        end = time.monotonic() + most_s
        while time.monotonic() < end:
            try:
                return os.read(self.device, 1000)
            except BlockingIOError:
                time.sleep(0.01)
        return b""

    def close(self):
        self.wire.close()
        os.close(self.device)


@pytest.fixture
def ends(tmp_path):
    both = Ends(tmp_path)
    yield both
    both.close()


def test_passes_on_both_ways_and_again(ends):
    for number in (1, 2):
        with ends.controller() as controller:
            controller.write(b"SVA 1 %d\n" % number)
            assert ends.heard() == b"SVA 1 %d\n" % number
            os.write(ends.device, b"0\n")
            assert controller.read(2) == b"0\n"
    assert [each.volts for each in ends.arrivals.copy()] == [1.0, 2.0]


def test_cuts_that_leave_the_port(ends):
    with ends.controller() as controller:
        for how, heard in (("hole", b""), ("late", b"SVA 1 5\n"), ("deaf", b"SVA 1 5\n")):
            ends.wire.cut(how)
            controller.write(b"SVA 1 5\n")
            assert ends.heard(0.2) == (heard if how == "deaf" else b"")
            os.write(ends.device, b"0\n")
            assert controller.read(1) == b""
            ends.wire.mend()
            if how == "late":
                assert ends.heard() == heard
    assert len(ends.arrivals.copy()) == 2


def test_unplugged(ends):
    with ends.controller() as controller:
        ends.wire.cut("refused")
        assert not ends.wire.place.exists()
        with pytest.raises((serial.SerialException, OSError)):
            controller.read(1)
    ends.wire.mend()
    with ends.controller() as controller:
        controller.write(b"SVA 1 6\n")
        assert ends.heard() == b"SVA 1 6\n"
