"""What the error frames of a CAN controller say: counted, and bus-off is the end of the link.

Only SocketCAN, and the test bus that follows it, tell the kinds of error apart (linux/can/error.h); of any other
interface error frames are counted and no more. How well a bus does is judged by its frames: the `state` of python-can
is not kept up by most interfaces.
"""

from __future__ import annotations

import can

from micromanip.driver import LinkError

TRANSMIT_TIMEOUT = 0x001
CONTROLLER = 0x004
NO_ACKNOWLEDGE = 0x020
BUS_OFF = 0x040
RESTARTED = 0x100

# second byte of a frame about the controller
RECEIVE_OVERFLOW = 0x01
WARNING = 0x04 | 0x08
PASSIVE = 0x10 | 0x20

_TELL_APART = ("socketcan", "micromanip")


class ErrorFrames:
    """Counters of what error frames reported."""

    def __init__(self, device: str, interface: str) -> None:
        self._device = device
        self._tells_apart = interface in _TELL_APART
        self.counters = dict.fromkeys(
            ("error_frames", "error_warning", "error_passive", "unacknowledged", "bus_off", "overflows"), 0
        )

    def take(self, message: can.Message) -> None:
        """Count an error frame. Raises LinkError if it says that the controller left the bus."""
        count = self.counters
        count["error_frames"] += 1
        if not self._tells_apart:
            return
        kind = message.arbitration_id
        if kind & BUS_OFF:
            count["bus_off"] += 1
            raise LinkError(f"bus-off on {self._device}: too many errors, check bit rates, wiring and terminators")
        if kind & (NO_ACKNOWLEDGE | TRANSMIT_TIMEOUT):
            count["unacknowledged"] += 1
        if kind & CONTROLLER and len(message.data) > 1:
            state = message.data[1]
            count["error_warning"] += bool(state & WARNING)
            count["error_passive"] += bool(state & PASSIVE)
            count["overflows"] += bool(state & RECEIVE_OVERFLOW)
