"""What the PDOs, SYNC and the heartbeats cost of the bus, and how late they are at worst."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from micromanip.driver import worst_case_s

from .options import CanOpenOptions
from .plan import SYNC, NodePlan, PdoPlan

_HEARTBEAT = 0x700


@dataclass(frozen=True)
class Frame:
    """A frame that comes again and again."""

    kind: str
    identifier: int
    rate_hz: float
    seconds: float
    """How long it keeps the bus, at worst."""


class Timing:
    """The frames that the configuration asks for."""

    def __init__(self, options: CanOpenOptions, nodes: Sequence[NodePlan]) -> None:
        self._options = options
        self.frames = tuple(_frames(options, nodes))

    def duration_s(self, length: int) -> float:
        """How long a frame of `length` bytes keeps the bus, at worst."""
        return worst_case_s(length, self._options.bitrate)

    def load(self) -> tuple[float, str, float]:
        """The bus's load: share, how it comes about, frames a second."""
        groups: dict[tuple[str, float], float] = {}
        for frame in self.frames:
            group = frame.kind, frame.seconds
            groups[group] = groups.get(group, 0.0) + frame.rate_hz
        detail = " + ".join(
            f"{rate_hz:.0f} {kind} x {seconds * 1e6:.0f} us" for (kind, seconds), rate_hz in groups.items()
        )
        share = sum(frame.rate_hz * frame.seconds for frame in self.frames)
        return share, detail, sum(frame.rate_hz for frame in self.frames)

    def arrival_s(self, identifier: int) -> float:
        """From being ready to being received, at worst: behind a frame that is on the bus, and all that go first.

        A SYNC makes all synchronous PDOs ready at once, so the SYNC is one of them.
        """
        ahead = sum(frame.seconds for frame in self.frames if frame.identifier <= identifier)
        behind = max((frame.seconds for frame in self.frames if frame.identifier > identifier), default=0.0)
        return ahead + behind

    def input_latency_s(self, pdo: PdoPlan) -> float:
        """From being measured to being received, at worst."""
        return pdo.options.latency_us * 1e-6 + self.arrival_s(pdo.mapping.identifier)

    def output_latency_s(self, pdo: PdoPlan) -> float:
        """From being sent to being in force, at worst: a synchronous one waits for the next SYNC."""
        waits_s = 1.0 / self._options.sync_hz if pdo.mapping.synchronous and self._options.sync_hz else 0.0
        return pdo.options.latency_us * 1e-6 + self.arrival_s(pdo.mapping.identifier) + waits_s


def _frames(options: CanOpenOptions, nodes: Sequence[NodePlan]) -> Iterable[Frame]:
    if options.sync_hz is not None:
        yield Frame("SYNC", SYNC, options.sync_hz, worst_case_s(0, options.bitrate))
    for plan in nodes:
        for pdo in plan.pdos:
            seconds = worst_case_s(pdo.mapping.length, options.bitrate)
            yield Frame(pdo.mapping.direction.upper(), pdo.mapping.identifier, pdo.options.rate_hz, seconds)
    beat_s = worst_case_s(1, options.bitrate)
    for plan in nodes:
        yield Frame("heartbeat", _HEARTBEAT + plan.options.node_id, 1e3 / plan.heartbeat_period_ms, beat_s)
    if options.heartbeat_period_ms is not None:
        yield Frame("heartbeat", _HEARTBEAT + options.own_node_id, 1e3 / options.heartbeat_period_ms, beat_s)
