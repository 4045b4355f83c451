"""A serial port that a simulated device is behind, opened as a program opens any port."""

import errno
import os
import select
import termios
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

    def open(self, baud=None):
        fileno = os.open(self.port.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._opened.append(fileno)
        if baud is not None:
            settings = termios.tcgetattr(fileno)
            settings[4] = settings[5] = getattr(termios, f"B{baud}")
            termios.tcsetattr(fileno, termios.TCSANOW, settings)
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


def waiting(fileno, count=1, within_s=5.0):
    """What the client reads, at least so many bytes."""
    data, give_up = b"", time.monotonic() + within_s
    while len(data) < count and time.monotonic() < give_up:
        if select.select([fileno], [], [], 0.01)[0]:
            data += os.read(fileno, 4096)
    return data


def test_bytes_take_their_time_on_the_line(bench):
    client = bench.open()
    bench.port.send(b"x" * 100)
    bench.port.send(b"y" * 20)
    bench.run(100 * BYTE_NS * 1e-9 - 1e-6)
    assert waiting(client, within_s=0.05) == b""
    bench.run(2e-6)
    assert waiting(client, 100) == b"x" * 100
    bench.run(20 * BYTE_NS * 1e-9)
    assert waiting(client, 20) == b"y" * 20
    assert bench.port.figures.busy_ns == pytest.approx(120 * BYTE_NS, abs=2)


@pytest.mark.parametrize(("half_duplex", "bytes_before"), [(False, 50), (True, 150)])
def test_directions_share_a_line_only_on_rs485(make, half_duplex, bytes_before):
    bench = make(half_duplex=half_duplex)
    client = bench.open()
    os.write(client, b"q" * 50)
    began_ns = bench.loop.time_ns
    bench.port.send(b"a" * 100)
    bench.until(lambda: bench.heard)
    assert bench.heard[0][0] - began_ns == pytest.approx(bytes_before * BYTE_NS, rel=0.05)


def test_what_is_sent_while_nobody_listens_is_lost(bench):
    bench.port.send(b"before")
    bench.run(0.01)
    client = bench.open()
    bench.port.send(b"now")
    bench.run(0.01)
    assert waiting(client, 3) == b"now"
    bench.close_client(client)
    bench.port.send(b"between")
    bench.run(0.01)
    again = bench.open()
    assert waiting(again, within_s=0.05) == b""
    os.write(again, b"hello")
    bench.until(lambda: bench.heard)
    assert bench.port.figures.bytes_lost == len("before") + len("between")


@pytest.mark.parametrize("baud", [9600, 230400])
def test_a_port_at_a_wrong_rate_hears_noise_and_sends_it(bench, baud):
    client = bench.open(baud)
    bench.port.send(b"E-727 ready\n")
    bench.run(0.01)
    noise = waiting(client)
    assert noise
    assert b"ready" not in noise
    os.write(client, b"*IDN?\n")
    bench.until(lambda: bench.heard)
    assert b"IDN" not in bench.heard[0][1]


def test_unplugged_and_back_under_the_same_name(bench):
    client = bench.open()
    bench.port.unplug()
    assert not bench.port.device.is_symlink()
    with pytest.raises(OSError) as caught:  # noqa: PT011
        os.write(client, b"x")
    assert caught.value.errno == errno.EIO
    bench.port.send(b"nobody")
    bench.run(0.05)
    bench.port.plug_in()
    again = bench.open()
    bench.port.send(b"back")
    bench.run(0.01)
    assert waiting(again, 4) == b"back"


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
