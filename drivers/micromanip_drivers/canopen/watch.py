"""Watching a running node: heartbeat, state, restarts, emergency messages."""

from __future__ import annotations

import struct

from canopen.emcy import EmcyError

from micromanip.io.bus_errors import DeviceFault, LinkError

OPERATIONAL = 5
_STATES = {0: "INITIALISING", 4: "STOPPED", OPERATIONAL: "OPERATIONAL", 127: "PRE-OPERATIONAL"}
_GUARD_TOGGLE = 0x80
_EMERGENCY = struct.Struct("<HB")
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
        self.state = "silent"
        """What its last heartbeat said."""
        self.operational = False
        """True once its heartbeat has said so."""

    def begin(self, time_ns: int) -> None:
        """It was told to start at `time_ns`."""
        self._heard_ns, self._fault, self.state, self.operational = time_ns, None, "silent", False

    def heartbeat(self, data: bytes, time_ns: int) -> None:
        """Its heartbeat. Raises LinkError if it says that the node restarted or left OPERATIONAL."""
        if not data:
            return
        state = data[0] & ~_GUARD_TOGGLE
        self._heard_ns, self.state = time_ns, _STATES.get(state, f"in state {state}")
        if state == 0:
            raise LinkError(f"node {self._name} has restarted (boot-up message)")
        if state == OPERATIONAL:
            self.operational = True
        elif self.operational:
            raise LinkError(f"node {self._name} is {self.state}, no longer OPERATIONAL")

    def emergency(self, data: bytes) -> None:
        """Its emergency message, or the one that takes it back."""
        if len(data) < _EMERGENCY.size:
            return
        code, register = _EMERGENCY.unpack_from(data)
        self._fault = None if code & 0xFF00 == 0 else f"emergency {described(code)}, error register 0x{register:02X}"

    def check(self, now_ns: int) -> None:
        """Raises DeviceFault while it reports an emergency, LinkError if it has been silent for too long."""
        if self._fault is not None:
            raise DeviceFault(f"node {self._name} reports {self._fault}")
        if now_ns - self._heard_ns > self._heartbeat_ms * 1_000_000:
            raise LinkError(f"node {self._name} gave no heartbeat for {self._heartbeat_ms} ms")


def described(code: int) -> str:
    """An emergency's code in words."""
    words = _COMMUNICATION.get(code) or EmcyError(code, 0, b"", 0.0).get_desc().lower()
    return f"0x{code:04X} ({words})" if words else f"0x{code:04X}"
