"""Watching a running node: heartbeat, state, restarts, emergency messages."""

from __future__ import annotations

import struct

from canopen.emcy import EmcyError

from micromanip.driver import DeviceFault, LinkError

OPERATIONAL = 5
_STATES = {0: "INITIALISING", 4: "STOPPED", OPERATIONAL: "OPERATIONAL", 127: "PRE-OPERATIONAL"}
_GUARD_TOGGLE = 0x80
_EMERGENCY = struct.Struct("<HB")
_OF_COMMUNICATION = (0x81, 0x82)
# CiA 301 names the codes of the communication one by one; of the others the library knows the class
_COMMUNICATION = {
    0x8110: "CAN overrun",
    0x8120: "CAN error passive",
    0x8130: "heartbeat of ours missing",
    0x8140: "recovered from bus-off",
    0x8150: "identifier collision",
    0x8210: "PDO too short",
    0x8220: "PDO too long",
    0x8240: "SYNC of wrong length",
    0x8250: "no outputs in time",
}


class Watch:
    """What a node said of itself since it was opened."""

    def __init__(self, name: str, heartbeat_ms: int) -> None:
        self._name = name
        self._heartbeat_ms = heartbeat_ms
        self._heard_ns = 0
        self._fault: str | None = None
        self._left: str | None = None
        self.state = "silent"
        """What its last heartbeat said."""
        self.operational = False
        """True if its last heartbeat said so."""
        self._running = False

    def begin(self, time_ns: int) -> None:
        """It is told to start, at `time_ns`: it need not be OPERATIONAL yet, and may still say that it missed us."""
        self._heard_ns, self._fault, self._left = time_ns, None, None
        self.state, self.operational, self._running = "silent", False, False

    def run(self) -> None:
        """All nodes have started: from now on it has to stay OPERATIONAL."""
        self._running = True

    @property
    def overdue_ns(self) -> int:
        """From then on its heartbeat is missing."""
        return self._heard_ns + self._heartbeat_ms * 1_000_000

    def heartbeat(self, data: bytes, time_ns: int) -> None:
        """Its heartbeat, which may say that it restarted or left OPERATIONAL."""
        if not data:
            return
        state = data[0] & ~_GUARD_TOGGLE
        self._heard_ns, self.state = time_ns, _STATES.get(state, f"in state {state}")
        self.operational = state == OPERATIONAL
        if state == 0:
            self._left = "has restarted (boot-up message)"
        elif self._running and not self.operational:
            self._left = f"is {self.state}, no longer OPERATIONAL"

    def emergency(self, data: bytes) -> None:
        """Its emergency message, or the one that takes it back."""
        if len(data) < _EMERGENCY.size:
            return
        code, register = _EMERGENCY.unpack_from(data)
        if code & 0xFF00 == 0:
            self._fault = self._fault if register else None  # one error of several has gone
        elif self._running or not blames_bus(code):
            self._fault = f"emergency {emergency_text(code)}, error register 0x{register:02X}"

    def check(self, now_ns: int) -> None:
        """Raises DeviceFault while it reports an emergency, LinkError if it left OPERATIONAL or is silent for too long.

        The emergency first: a node that leaves OPERATIONAL says why by one.
        """
        if self._fault is not None:
            raise DeviceFault(f"node {self._name} reports {self._fault}")
        if self._left is not None:
            raise LinkError(f"node {self._name} {self._left}")
        if now_ns > self.overdue_ns:
            raise LinkError(f"node {self._name} gave no heartbeat for {self._heartbeat_ms} ms")


def blames_bus(code: int) -> bool:
    """True for an emergency's code that blames the bus, or us."""
    return code >> 8 in _OF_COMMUNICATION


def emergency_text(code: int) -> str:
    """An emergency's code in words."""
    words = _COMMUNICATION.get(code) or EmcyError(code, 0, b"", 0.0).get_desc().lower()
    return f"0x{code:04X} ({words})" if words else f"0x{code:04X}"
