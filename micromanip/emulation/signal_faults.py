"""What a sensor does wrong while the device that carries it goes on as if nothing were."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass
class SignalFault:
    """One fault of one signal; `value` in the signal's unit, for a drift per second."""

    kind: str
    """freeze, offset, drift, nan."""
    value: float
    since_ns: int
    until_ns: int | None
    held: float | None = None


class SignalFaults:
    """Spoils readings by signal name. The last fault given to a signal replaces the one before."""

    def __init__(self) -> None:
        self._faults: dict[str, SignalFault] = {}

    def begin(self, signal: str, kind: str, value: float, now_ns: int, for_s: float | None) -> None:
        """From now on; None is for ever."""
        until_ns = None if for_s is None else now_ns + round(for_s * 1e9)
        self._faults[signal] = SignalFault(kind, value, now_ns, until_ns)

    @property
    def any(self) -> bool:
        """Whether there is one at all."""
        return bool(self._faults)

    def clear(self) -> None:
        """End them all."""
        self._faults.clear()

    def spoiled(self, signal: str, value: float, now_ns: int) -> float:
        """What is read of `signal` in place of `value`."""
        fault = self._faults.get(signal)
        if fault is None:
            return value
        if fault.until_ns is not None and now_ns >= fault.until_ns:
            del self._faults[signal]
            return value
        match fault.kind:
            case "freeze":
                fault.held = value if fault.held is None else fault.held
                return fault.held
            case "offset":
                return value + fault.value
            case "drift":
                return value + fault.value * (now_ns - fault.since_ns) * 1e-9
        return math.nan
