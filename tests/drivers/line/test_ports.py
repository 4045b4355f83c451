"""Serial lines, TCP and UDP: what is sent, what comes, and how it ends."""

import contextlib
import os
import socket
import time

import pytest
from micromanip_drivers.line.options import SerialPort, TcpPort, UdpPort
from micromanip_drivers.line.serial_port import Echo, SerialLine
from micromanip_drivers.line.tcp_port import TcpConnection, UdpDatagrams

from campaigns.running_controller import until
from micromanip.bus.errors import LinkError, TransientError

from .scripted_port import raised
from .wires import PtyWire, free_port


def soon(seconds=1.0):
    return time.monotonic_ns() + round(seconds * 1e9)


def received(port, seconds=1.0):
    return b"".join(data for data, _ in port.receive(soon(seconds)))


@contextlib.contextmanager
def serial_line(**options):
    wire = PtyWire()
    wire.start()
    port = SerialLine(SerialPort.model_validate({**wire.options["serial"], **options}))
    try:
        port.open(soon())
        yield wire, port
    finally:
        port.close()
        wire.kill()


def test_serial_line_both_ways():
    with serial_line() as (wire, port):
        port.send(b"\x00\xff\n\r\x11\x13ask")  # nothing is changed on the way, no flow control
        assert wire.read(1.0) == b"\x00\xff\n\r\x11\x13ask"
        wire.write(b"\x00\r\n\x11\x13\x03answer")
        assert received(port) == b"\x00\r\n\x11\x13\x03answer"
        assert port.receive(0) == []
        assert port.counters["bytes_out"] == 9


def test_serial_line_has_one_owner():
    with serial_line() as (wire, _), pytest.raises(LinkError, match="can't be opened"):
        SerialLine(SerialPort.model_validate(wire.options["serial"])).open(soon())


def test_unplugged_and_back():
    with serial_line() as (wire, port):
        wire.kill()
        with pytest.raises(LinkError, match="is gone"):
            port.receive(soon(0.1))
        with pytest.raises(LinkError, match="is gone"):
            port.send(b"x")
        port.close()
        with pytest.raises(LinkError, match="no such device"):
            port.open(soon())
        wire.start()
        port.open(soon())
        port.send(b"again")
        assert wire.read(1.0) == b"again"


def test_bytes_of_before_are_forgotten_by_opening():
    with serial_line() as (wire, port):
        port.close()
        wire.write(b"old")
        port.open(soon())
        wire.write(b"new")
        assert received(port) == b"new"


def test_what_does_not_fit_is_refused_and_frames_stay_whole():
    """The device reads nothing for a while: nothing is queued without end, and no half frame is left behind."""
    with serial_line() as (wire, port):
        frame = bytes(range(100))
        problem = raised(lambda: port.send(frame))
        assert isinstance(problem, TransientError)
        assert "still waits to be sent" in str(problem)
        sent = port.counters["bytes_out"] // len(frame)
        got = os.read(wire.master, 1000)
        time.sleep(0.02)
        while port.counters["transmit_full"] < 3:  # the rest of the last frame goes first
            with contextlib.suppress(TransientError):
                port.send(frame)
                sent += 1
        while data := wire.read(0.1):
            got += data
            port.receive(0)  # the rest of a frame follows as soon as there is room
        assert got == frame * sent
        port.send(frame)
        assert wire.read(1.0) == frame


def test_echo_that_is_another():
    echo = Echo()
    echo.sent(b"abcd")
    assert echo.without(b"ab") == b""
    assert echo.without(b"xd12") == b"xd12"
    assert echo.without(b"34") == b"34"
    assert echo.errors == 1


@pytest.fixture
def server():
    with socket.create_server(("127.0.0.1", 0)) as one:
        one.settimeout(2.0)
        yield one


@contextlib.contextmanager
def connected(server, silence_ms=200.0):
    port = TcpConnection(TcpPort(host="127.0.0.1", port=server.getsockname()[1]), silence_ms)
    port.open(soon())
    device, _ = server.accept()
    try:
        with device:
            yield device, port
    finally:
        port.close()


def test_half_open_connection_of_one_who_only_writes(server):
    """What is not acknowledged for so long ends the connection: here by a window that stays shut."""
    with connected(server, silence_ms=100.0) as (_, port):

        def go_on():
            with contextlib.suppress(TransientError):
                port.send(bytes(50_000))
            port.receive(soon(0.005))

        assert isinstance(raised(go_on), LinkError)


def udp_pair(listen=None):
    device = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    device.bind(("127.0.0.1", 0))
    device.settimeout(2.0)
    port = UdpDatagrams(UdpPort(host="127.0.0.1", port=device.getsockname()[1], listen=listen))
    port.open(soon())
    return device, port


def test_udp_both_ways():
    device, port = udp_pair()
    with device, contextlib.closing(port):
        port.send(b"question")
        data, sender = device.recvfrom(100)
        assert data == b"question"

        def stamped_by_kernel():
            """Whether both came with the time of their arrival, not with ours 20 ms later."""
            before_ns = time.monotonic_ns()
            device.sendto(b"one", sender)
            device.sendto(b"two", sender)
            after_ns = time.monotonic_ns()
            time.sleep(0.02)
            (one, one_ns), (two, two_ns) = port.receive(soon())
            assert (one, two) == (b"one", b"two")
            return before_ns <= one_ns <= two_ns <= after_ns

        until(stamped_by_kernel, "the kernel's own stamps")  # the kernel begins to stamp a moment after it was asked to


def test_udp_of_strangers_that_came_before_it_was_connected(monkeypatch):
    """Between bind and connect the port is everybody's; the sender's address tells."""
    listen = free_port(socket.SOCK_DGRAM)
    device = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    device.bind(("127.0.0.1", 0))

    class Overheard(socket.socket):
        def connect(self, address):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.sendto(b"not ours", ("127.0.0.1", listen))
            super().connect(address)

    monkeypatch.setattr(socket, "socket", Overheard)
    port = UdpDatagrams(UdpPort(host="127.0.0.1", port=device.getsockname()[1], listen=listen))
    port.open(soon())
    monkeypatch.undo()
    with device, contextlib.closing(port):
        device.sendto(b"ours", ("127.0.0.1", listen))
        assert received(port) == b"ours"
        assert port.counters["strangers"] == 1


class Breaking(UdpDatagrams):
    """Gives one datagram, and then the error of what was sent before."""

    def _read(self, descriptor):
        if self.given:
            raise ConnectionRefusedError("nobody listens")
        self.given = True
        return b"last words", 1

    def _connect(self, deadline_ns):
        self.given = False
        self.ends = os.pipe()
        os.write(self.ends[1], b"x")
        return self.ends[0]

    def _disconnect(self):
        while self.ends:
            os.close(self.ends[0])
            self.ends = self.ends[1:]

    ends = ()


def test_what_came_before_an_error_is_not_lost():
    port = Breaking(UdpPort(host="127.0.0.1", port=1))
    port.open(soon())
    with contextlib.closing(port):
        assert received(port) == b"last words"
        with pytest.raises(LinkError, match="nobody listens"):
            port.receive(soon())
