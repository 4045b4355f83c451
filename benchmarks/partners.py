"""Partners of the benchmarks of exchanges, a process each: ``python -m benchmarks.partners KIND [ARGUMENT...]``.

can CHANNEL N: frames to each client, as fast as it listens, from compiled code. frames: frames on a pseudo terminal.
answer: a line of text for each line, on a pseudo terminal. serve: the same over TCP. modbus: a Modbus TCP unit.
terminals INTERFACE INPUTS_AT TERMINALS COUNTER_AT COUNTER STATUS_AT: EtherCAT terminals, each frame goes back as if all
of them had acted on it. Each says when it is ready, and where it is found. bare CHANNEL SECONDS is no partner but the
yardstick of `can_worker`: python-can alone that receives all and sends the voltages, and says its share of a CPU.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time
import tty
from collections.abc import Callable

SYNC, FRAME_BYTES, COUNTS = b"\xaa\x55", 20, 1 << 16
REPLY = b"1=12.5000 \n2=-0.2500 \n3=100.0000\n"
REGISTERS_READ, REGISTERS_WRITTEN = 21, 4
BITRATE, DATA_BITRATE = 1_000_000, 5_000_000
_AT_ONCE = 16  # a pseudo terminal holds 4096 bytes
_SENSORS, _SENSOR_BYTES, _VOLTAGES, _VOLTAGES_HZ = 0x101, 24, 0x100, 2000.0


def _say(what: object) -> None:
    print(what, flush=True)  # noqa: T201


def _terminal() -> int:
    """Our end of a pseudo terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    _say(os.ttyname(slave))
    return master


def _answer() -> None:
    master = _terminal()
    while True:
        if os.read(master, 4096).endswith(b"\n"):
            os.write(master, REPLY)


def _frames() -> None:
    from fastcrc import crc16

    def frame(count: int) -> bytes:
        body = SYNC + count.to_bytes(2, "little") + bytes(FRAME_BYTES - 6)
        return body + crc16.modbus(body).to_bytes(2, "little")

    master, frames = _terminal(), [frame(count) for count in range(COUNTS)]
    blocks = [b"".join(frames[first : first + _AT_ONCE]) for first in range(0, COUNTS, _AT_ONCE)]
    os.read(master, 1)  # somebody listens
    os.set_blocking(master, False)
    while True:
        for block in blocks:
            rest = block
            while rest:
                select.select([], [master], [])
                rest = rest[os.write(master, rest) :]


def _serve(answer: Callable[[bytes], bytes]) -> None:
    """One client after the other over TCP."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        _say(server.getsockname()[1])
        while True:
            with server.accept()[0] as client, contextlib.suppress(OSError):
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                while request := client.recv(4096):
                    client.sendall(answer(request))


def _registers(request: bytes) -> bytes:
    """It looks at hardly more than the transaction number, so that it holds nobody up."""
    size = 2 * request[11]
    return request[:4] + (3 + size).to_bytes(2, "big") + request[6:8] + bytes((size, *bytes(size)))


def _can(channel: str, count: str) -> None:
    """It stands in for the hub of the test bus, without a bus time."""
    import numpy as np

    from micromanip.rt.jit import prepare
    from micromanip.testbus.client_port import address
    from micromanip.testbus.frame import STAMP, Frame, pack

    from .flood import flood

    def packet(i: int) -> bytes:
        """Sensors of `can/manipulator.dbc`, zeros but for the counter in the last two bytes."""
        data = bytes(_SENSOR_BYTES - 2) + (i % COUNTS).to_bytes(2, "little")
        return STAMP.pack(0) + pack(Frame(_SENSORS, data, fd=True, bitrate_switch=True))

    packets = np.array([list(packet(i)) for i in range(int(count))], np.uint8)
    prepare(flood)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(address(channel))
        listener.listen()
        _say("ready")
        while True:
            client = listener.accept()[0]
            client.send(json.dumps({"bitrate": BITRATE, "data_bitrate": DATA_BITRATE}).encode())
            with contextlib.suppress(OSError):
                flood(client.fileno(), packets)
                client.recv(1)  # until it has gone


def _bare(channel: str, seconds: str) -> None:
    import can

    message = can.Message(
        arbitration_id=_VOLTAGES, data=bytes(8), is_extended_id=False, is_fd=True, bitrate_switch=True
    )
    with can.Bus(channel, "micromanip", ignore_config=True, fd=True, bitrate=BITRATE, data_bitrate=DATA_BITRATE) as bus:
        begin, used = time.monotonic(), time.process_time()
        due = begin
        while (now := time.monotonic()) < begin + float(seconds):
            if now >= due:
                due += 1.0 / _VOLTAGES_HZ
                try:
                    bus.send(message, timeout=0)
                except can.CanOperationError:
                    continue  # the queue is full
            bus.recv(max(0.0, due - now))
        _say((time.process_time() - used) / (time.monotonic() - begin))


def _terminals(interface: str, *numbers: str) -> None:
    from micromanip.bus.ethercat.al_states import OP
    from micromanip.bus.ethercat.frames import HEADER_BYTES, PROCESSED, STATUS_BYTES, unframed
    from micromanip.bus.ethercat.registers import APRD, APRW, APWR, ARMW, BRD, BRW, BWR
    from micromanip.emulation.ethercat.port import EthernetPort
    from micromanip.emulation.line.port import Peer
    from micromanip.errors import DeviceUnavailable
    from micromanip.testbus.event_loop import EventLoop

    inputs_at, terminals, counter_at, counter, status_at = map(int, numbers)
    inputs = bytes(37 * k % 251 for k in range(counter_at - inputs_at))
    counted = {APRD, APWR, APRW, BRD, BWR, BRW, ARMW}  # each slave counts the position up

    def hear(data: bytes, peer: Peer) -> None:
        frame = bytearray(data)
        frame[6] |= PROCESSED  # in the sender's address
        frame[inputs_at:counter_at] = inputs
        for at, number in ((counter_at, counter), (status_at, OP), (status_at + STATUS_BYTES, terminals)):
            frame[at : at + 2] = number.to_bytes(2, "little")
        at = HEADER_BYTES
        for datagram in unframed(bytes(frame)):
            if datagram.command in counted:
                frame[at + 2 : at + 4] = terminals.to_bytes(2, "little")
            at += datagram.size
        peer.send(bytes(frame))

    loop = EventLoop()
    signal.signal(signal.SIGTERM, lambda *_: loop.stop())
    try:
        port = EthernetPort(loop, interface, hear)
    except DeviceUnavailable as problem:
        _say(problem)
        return
    _say("up")
    loop.run()
    port.close()


_KINDS: dict[str, Callable[..., None]] = {
    "can": _can,
    "frames": _frames,
    "answer": _answer,
    "serve": lambda: _serve(lambda _: REPLY),
    "modbus": lambda: _serve(_registers),
    "terminals": _terminals,
    "bare": _bare,
}

if __name__ == "__main__":
    _KINDS[sys.argv[1]](*sys.argv[2:])
