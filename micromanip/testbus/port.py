"""A participant's controller on the simulated bus: transmit queue, error counters and states of ISO 11898-1."""

from __future__ import annotations

from collections import deque
from enum import IntEnum
from typing import NamedTuple, Protocol

from .frame import Controller, Frame, bus_error, bus_off, controller_error, restarted

_LEAST_WARNING, LEAST_PASSIVE, _LEAST_BUS_OFF = 96, 128, 256
"""Error counts at which the states begin."""


class State(IntEnum):
    """How much a controller still trusts itself."""

    ACTIVE = 0
    WARNING = 1
    PASSIVE = 2
    BUS_OFF = 3


class Transmission(NamedTuple):
    """A frame on its way."""

    frame: Frame
    packed: bytes
    priority: int
    duration_ns: int
    """How long it keeps the bus."""
    arrival_ns: int
    """When it came into the transmit queue."""
    repeated: bool = False
    """Sent again although it had arrived."""


class Node(Protocol):
    """A participant in the hub's own process."""

    def on_frame(self, frame: Frame, time_ns: int) -> None:
        """Take a frame of another participant that ended at `time_ns`."""


class Port:
    """One participant, whatever it is; who attaches it says how it gets its frames."""

    def __init__(self, name: str, queue_frames: int, restart_ns: int | None = None) -> None:
        self.name = name
        self.queue: deque[Transmission] = deque()
        self.queue_frames = queue_frames
        self.restart_ns = restart_ns
        """How long after bus-off it takes part again by itself; None: it doesn't."""
        self.leaving = False
        """Gone, but for what it had queued."""
        self.transmit_errors = 0
        self.receive_errors = 0
        self._refusing = False
        self._least_transmit_errors = 0
        self._told = State.ACTIVE

    @property
    def state(self) -> State:
        """Follows from the error counters."""
        if self.transmit_errors >= _LEAST_BUS_OFF:
            return State.BUS_OFF
        worst = max(self.transmit_errors, self.receive_errors)
        if worst >= LEAST_PASSIVE:
            return State.PASSIVE
        return State.WARNING if worst >= _LEAST_WARNING else State.ACTIVE

    @property
    def full(self) -> bool:
        """No further frame is taken."""
        return self._refusing or len(self.queue) >= self.queue_frames

    def deliver(self, transmission: Transmission, time_ns: int) -> None:
        """Hand over a frame of another participant."""
        raise NotImplementedError

    def report(self, frame: Frame, time_ns: int) -> None:
        """Hand over an error frame of its own controller; the default is not to."""

    def queue_changed(self) -> None:
        """A frame has left the queue or come into it."""

    def sent(self, time_ns: int) -> None:
        """A frame of its own arrived at the others."""
        if self.transmit_errors > self._least_transmit_errors:
            self.transmit_errors -= 1
            self.report_state(time_ns)

    def received(self, time_ns: int) -> None:
        """A frame of another arrived."""
        if self.receive_errors:
            self.receive_errors = min(self.receive_errors, LEAST_PASSIVE) - 1
            self.report_state(time_ns)

    def failed(self, own: bool, time_ns: int) -> None:
        """A frame was destroyed on the bus; `own` if it was its own."""
        self.report(bus_error(own), time_ns)
        if own:
            self.transmit_errors += 8
        else:
            self.receive_errors = min(self.receive_errors + 1, _LEAST_BUS_OFF - 1)
        self.report_state(time_ns)

    def go_bus_off(self, time_ns: int) -> None:
        """As if it had failed to send too often."""
        self.transmit_errors = _LEAST_BUS_OFF
        self.report_state(time_ns)

    def keep_transmit_errors(self, least: int, time_ns: int) -> None:
        """Don't let the counter of transmit errors fall below `least`."""
        self._least_transmit_errors = least
        self.transmit_errors = max(self.transmit_errors, least)
        self.report_state(time_ns)

    def refuse(self, refusing: bool) -> None:
        """Take no frames although the queue has room, or take them again."""
        self._refusing = refusing
        self.queue_changed()

    def restart(self, time_ns: int) -> None:
        """Take part again after bus-off."""
        self.transmit_errors = self.receive_errors = 0
        self._told = State.ACTIVE
        self.report(restarted(), time_ns)

    def report_state(self, time_ns: int) -> None:
        """Tell the client if the state isn't what it was."""
        state = self.state
        if state is self._told:
            return
        self._told = state
        if state is State.BUS_OFF:
            self.queue.clear()
            self.queue_changed()
            self.report(bus_off(), time_ns)
            return
        by_transmission = self.transmit_errors >= self.receive_errors
        status = {
            State.ACTIVE: Controller.ACTIVE,
            State.WARNING: Controller.TX_WARNING if by_transmission else Controller.RX_WARNING,
            State.PASSIVE: Controller.TX_PASSIVE if by_transmission else Controller.RX_PASSIVE,
        }[state]
        self.report(controller_error(status, self.transmit_errors, self.receive_errors), time_ns)


class NodePort(Port):
    """A node in the hub's own process; it isn't told of error frames."""

    def __init__(self, node: Node, queue_frames: int, restart_ns: int) -> None:
        super().__init__(type(node).__name__, queue_frames, restart_ns)
        self.node = node

    def deliver(self, transmission: Transmission, time_ns: int) -> None:
        self.node.on_frame(transmission.frame, time_ns)
