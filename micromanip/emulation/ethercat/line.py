"""A line of slaves, or a ring that ends at the master again: frames go through them, their applications do the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from micromanip.rt.jit import prepare

from .application import Application
from .controller import ESC, pass_time
from .frame import NOT_ETHERCAT, passed
from .terminal import Terminal

_HOP_NS = 750
"""What a slave and a cable to it delay a frame by, each way."""
NEAR, FAR, NOWHERE = 0, 1, -1
"""The ends of the line: where the master sends from, and where a ring comes back to it."""
_MOST_BYTES = 2048


@dataclass(frozen=True)
class Way:
    """What becomes of a frame that comes in at an end: slaves `first` up to `end` act on it, and it leaves at `out`."""

    first: int
    end: int
    out: int


class Line:
    """Slaves in their order from the master."""

    def __init__(
        self,
        terminals: Sequence[Terminal],
        left_op: Callable[[], None] = lambda: None,
        is_ring: bool = False,
        hop_ns: int = _HOP_NS,
    ) -> None:
        """`left_op` is called when any of them leaves OP; `is_ring` is whether a cable leads back from the last one.

        A slave, with the cable to it, delays a frame by `hop_ns` each way.
        """
        self.controllers = np.zeros(len(terminals), ESC)
        self.applications = [
            Application(c, t, left_op, self.relink) for c, t in zip(self.controllers, terminals, strict=True)
        ]
        self._hop_ns = hop_ns
        self.controllers["to_ns"] = hop_ns * np.arange(len(terminals))
        self._data = np.zeros(_MOST_BYTES, np.uint8)
        self._is_ring = is_ring
        self.cuts: set[int] = set()
        """Places at which the cable is cut: behind so many slaves."""
        self.ways: tuple[Way, Way]
        self.relinked: Callable[[], None] = lambda: None
        """Called when the ways may have changed."""
        self.relink()
        self.awake_ns = 0
        """When this process went on last, 0 before the first tick."""
        prepare(passed, pass_time)

    def swap(self, k: int, now_ns: int) -> None:
        """Slave `k` and the one behind it change places, which takes both from the power."""
        first, second = self.applications[k : k + 2]
        one, other = first.terminal, second.terminal
        first.become(other, now_ns)
        second.become(one, now_ns)
        self.relink()

    def relink(self) -> None:
        """See anew who has a neighbour: a slave closes a port without one, so that frames turn back there.

        Slaves act on what comes from port 0 only, a closed port 0 included: what comes from the far end passes them on
        its way to where the line is broken, and is acted on as it comes back.
        """
        count = len(self.applications)
        broken = [k in self.cuts for k in range(count + 1)]
        broken[count] |= not self._is_ring
        for k, controller in enumerate(self.controllers):
            if not controller["powered"]:
                broken[k] = broken[k + 1] = True
            broken[k + 1] |= self.applications[k].is_closed
        places = [k for k, is_broken in enumerate(broken) if is_broken]
        near, far = (places[0], places[-1]) if places else (count, count)
        self.ways = (
            Way(0, near, FAR if not places else NEAR if near > 0 else NOWHERE),
            Way(far, count, NEAR if not places else FAR if far < count else NOWHERE),
        )
        for k, (controller, application) in enumerate(zip(self.controllers, self.applications, strict=True)):
            application.link(before=not broken[k], behind=not broken[k + 1])
            controller["returns"] = int(bool(places) and not broken[k + 1])
            controller["back_ns"] = 2 * self._hop_ns * max(0, near - 1 - k)
        self.relinked()

    def passed(self, frame: bytes, now_ns: int, end: int = NEAR) -> bytes | None:
        """The frame, which came in at an end, as it leaves; None for one that is not EtherCAT, or leaves nowhere."""
        way = self.ways[end]
        if way.out == NOWHERE:
            return None
        self._data[: len(frame)] = np.frombuffer(frame, np.uint8)
        if passed(self.controllers[way.first : way.end], self._data, len(frame), now_ns) == NOT_ETHERCAT:
            return None
        self.serve(now_ns)
        return self._data[: len(frame)].tobytes()

    def serve(self, now_ns: int) -> None:
        """Let each application do what its controller has kept for it."""
        for controller, application in zip(self.controllers, self.applications, strict=True):
            if controller["events"] and controller["powered"]:
                application.serve(now_ns)

    def tick(self, now_ns: int) -> None:
        """Let time pass for watchdogs."""
        if pass_time(self.controllers, self.awake_ns or now_ns, now_ns):
            self.serve(now_ns)
        self.awake_ns = now_ns
