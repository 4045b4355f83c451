"""A line of slaves: frames go through all of them, their applications do the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from micromanip.rt.jit import prepare

from .application import Application
from .controller import ESC, NOT_ETHERCAT, passed
from .terminal import Terminal

_HOP_NS, _CABLE_NS = 700, 50
"""What a slave and a cable to it delay a frame by, each way."""
_MOST_BYTES = 2048


class Line:
    """Slaves in their order from the master."""

    def __init__(self, terminals: Sequence[Terminal], left_op: Callable[[], None] = lambda: None) -> None:
        """`left_op` is called when any of them leaves OP."""
        self.controllers = np.zeros(len(terminals), ESC)
        self.applications = [Application(c, t, left_op) for c, t in zip(self.controllers, terminals, strict=True)]
        last = len(terminals) - 1
        for k, controller in enumerate(self.controllers):
            controller["to_ns"] = k * (_HOP_NS + _CABLE_NS)
            controller["back_ns"] = 2 * (last - k) * (_HOP_NS + _CABLE_NS)
        self._data = np.zeros(_MOST_BYTES, np.uint8)
        self.relink()
        prepare(passed)

    def swap(self, k: int, now_ns: int) -> None:
        """Slave `k` and the one behind it change places, which takes both from the power."""
        first, second = self.applications[k : k + 2]
        one, other = first.terminal, second.terminal
        for application, terminal in ((first, other), (second, one)):
            application.become(terminal, now_ns)
        self.relink()

    def relink(self) -> None:
        """See anew who has a neighbour behind it."""
        powered = [bool(controller["powered"]) for controller in self.controllers]
        for k, application in enumerate(self.applications):
            application.link(not any(powered[k + 1 : k + 2]))

    def passed(self, frame: bytes, now_ns: int) -> bytes | None:
        """The frame as it comes back; None for one that is not EtherCAT."""
        self._data[: len(frame)] = np.frombuffer(frame, np.uint8)
        if passed(self.controllers, self._data, len(frame), now_ns) == NOT_ETHERCAT:
            return None
        self.serve(now_ns)
        return self._data[: len(frame)].tobytes()

    def serve(self, now_ns: int) -> None:
        """Let each application do what its controller has kept for it."""
        for controller, application in zip(self.controllers, self.applications, strict=True):
            if controller["events"] and controller["powered"]:
                application.serve(now_ns)

    def tick(self, now_ns: int) -> None:
        """Watchdogs."""
        for controller, application in zip(self.controllers, self.applications, strict=True):
            if controller["powered"]:
                application.tick(now_ns)
