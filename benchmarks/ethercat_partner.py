"""Terminals for `ethercat_exchange`: each frame goes back as if all of them had acted on it.

``python -m benchmarks.ethercat_partner INTERFACE INPUTS_AT POSITION_AT TERMINALS WKC_AT WKC STATUS_AT``: these say
where in a frame inputs begin, where the broadcast counts, where the working counters stand, and what they must come to.
It says `up`, or why not.
"""

from __future__ import annotations

import signal
import sys

from micromanip.bus.ethercat.al_states import OP
from micromanip.bus.ethercat.frames import PROCESSED, STATUS_BYTES
from micromanip.emulation.ethercat.port import EthernetPort
from micromanip.emulation.line.port import Peer
from micromanip.errors import DeviceUnavailable
from micromanip.testbus.event_loop import EventLoop

_SENDER = 6


def main() -> None:
    """Go on until it is told to end."""
    interface, *numbers = sys.argv[1:]
    inputs_at, position_at, terminals, counter_at, counter, status_at = map(int, numbers)
    inputs = bytes(37 * k % 251 for k in range(counter_at - inputs_at))

    def hear(data: bytes, peer: Peer) -> None:
        frame = bytearray(data)
        frame[_SENDER] |= PROCESSED
        frame[inputs_at:counter_at] = inputs
        for at, number in (
            (position_at, terminals),
            (counter_at, counter),
            (status_at, OP),
            (status_at + STATUS_BYTES, terminals),
        ):
            frame[at : at + 2] = number.to_bytes(2, "little")
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


if __name__ == "__main__":
    main()
