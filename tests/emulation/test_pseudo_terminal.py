"""A serial port that a simulated device is behind, opened as a program opens any port."""

import os
import time

import pytest
from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.line.pseudo_terminal import PseudoTerminal
from micromanip.errors import DeviceUnavailable

BAUD = 115200
BYTE_NS = 1e10 / BAUD


class Bench:
    """One port, and whoever opens it."""

    def __init__(self, device, **options):
        self.loop = VirtualLoop()
        self.heard = []
        self.port = PseudoTerminal(self.loop, device, options.pop("baud", BAUD), self._hear, **options)
        self._opened = []

    def _hear(self, data):
        self.heard.append((self.loop.time_ns, data))

    def open(self):
        fileno = os.open(self.port.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._opened.append(fileno)
        self.run(0.02)
        return fileno

    def close_client(self, fileno):
        self._opened.remove(fileno)
        os.close(fileno)
        self.run(0.01)

    def run(self, seconds):
        self.loop.run(self.loop.time_ns + round(seconds * 1e9))

    def until(self, condition):
        """The kernel hands bytes over in a thread of its own: let it."""
        give_up = time.monotonic() + 5
        while not condition():
            assert time.monotonic() < give_up
            self.run(0.001)

    def close(self):
        for fileno in self._opened:
            os.close(fileno)
        self.port.close()
        self.loop.close()


@pytest.fixture
def make(tmp_path, closing):
    return lambda **options: closing(Bench(tmp_path / "ttyTest", **options))


@pytest.fixture
def bench(make):
    return make()


@pytest.mark.parametrize(("half_duplex", "bytes_before"), [(False, 50), (True, 150)])
def test_directions_share_a_line_only_on_rs485(make, half_duplex, bytes_before):
    bench = make(half_duplex=half_duplex)
    client = bench.open()
    os.write(client, b"q" * 50)
    began_ns = bench.loop.time_ns
    bench.port.send(b"a" * 100)
    bench.until(lambda: bench.heard)
    assert bench.heard[0][0] - began_ns == pytest.approx(bytes_before * BYTE_NS, rel=0.05)


@pytest.mark.parametrize("kind", ["file", "link", "dangling"])
def test_what_is_there_is_never_replaced(tmp_path, kind):
    device = tmp_path / "ttyUSB0"
    if kind == "file":
        device.write_text("real")
    else:
        device.symlink_to("/dev/null" if kind == "link" else tmp_path / "gone")
    with pytest.raises(DeviceUnavailable, match="ttyUSB0 exists, and is never replaced"):
        PseudoTerminal(VirtualLoop(), device, BAUD, print)
    assert device.is_symlink() or device.read_text() == "real"


def test_what_a_killed_process_left_is_replaced(tmp_path):
    device = tmp_path / "tty"
    device.symlink_to("/dev/pts/9999")
    Bench(device).close()
    assert not device.is_symlink()


def test_two_devices_on_one_path_are_refused(bench):
    with pytest.raises(DeviceUnavailable, match="simulated by another process already"):
        PseudoTerminal(bench.loop, bench.port.device, BAUD, print)
    assert bench.port.device.is_symlink()
