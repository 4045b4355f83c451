"""Terminals for `ethercat_exchange`: each frame goes back as if all of them had acted on it.

``python -m benchmarks.ethercat_partner INTERFACE INPUTS_AT TERMINALS WKC_AT WKC STATUS_AT``: these say where in a
frame inputs begin, where the working counters stand, and what they must come to. It says `up`, or why not.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator

from micromanip.bus.ethercat.al_states import OP
from micromanip.bus.ethercat.frames import HEADER_BYTES, PROCESSED, STATUS_BYTES, unframed
from micromanip.bus.ethercat.registers import APRD, APRW, APWR, ARMW, BRD, BRW, BWR
from micromanip.emulation.ethercat.port import EthernetPort
from micromanip.emulation.line.port import Peer
from micromanip.errors import DeviceUnavailable
from micromanip.testbus.event_loop import EventLoop

_SENDER = 6
_COUNTED = {APRD, APWR, APRW, BRD, BWR, BRW, ARMW}
"""Commands of which each slave counts the position up."""


def main() -> None:
    """Go on until it is told to end."""
    interface, *numbers = sys.argv[1:]
    inputs_at, terminals, counter_at, counter, status_at = map(int, numbers)
    inputs = bytes(37 * k % 251 for k in range(counter_at - inputs_at))

    def hear(data: bytes, peer: Peer) -> None:
        frame = bytearray(data)
        frame[_SENDER] |= PROCESSED
        frame[inputs_at:counter_at] = inputs
        for at, number in ((counter_at, counter), (status_at, OP), (status_at + STATUS_BYTES, terminals)):
            frame[at : at + 2] = number.to_bytes(2, "little")
        for at in _positions(frame):
            frame[at : at + 2] = terminals.to_bytes(2, "little")
        peer.send(bytes(frame))

    loop = EventLoop()
    signal.signal(signal.SIGTERM, lambda *_: loop.stop())
    try:
        port = EthernetPort(loop, interface, hear)
    except DeviceUnavailable as problem:
        print(problem, flush=True)  # noqa: T201
        return
    print("up", flush=True)  # noqa: T201
    loop.run()
    port.close()


def _positions(frame: bytearray) -> Iterator[int]:
    """Where the positions stand that slaves count up."""
    at = HEADER_BYTES
    for datagram in unframed(bytes(frame)):
        if datagram.command in _COUNTED:
            yield at + 2
        at += datagram.size


if __name__ == "__main__":
    main()
