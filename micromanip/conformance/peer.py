"""What the suite needs from a driver's author: a device to talk to, and vectors computed by hand."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import pytest


@dataclass(frozen=True)
class Golden:
    """Values of channels, and what they are on the wire: worked out by hand from the device's manual."""

    values: Mapping[str, float]
    """Inputs: of the channels that it fills. Outputs: of all of them."""
    wire: tuple[bytes, ...]
    """Units as the peer sends and receives them: datagrams, frames, lines."""


class Peer(ABC):
    """A device on a bus of its own, in this process or another; not started when it is built.

    Only `options`, `start` and `kill` must be there. A hook that a bus can't offer is left as it is: the checks that
    need it are skipped, and say so.
    """

    @property
    @abstractmethod
    def options(self) -> Mapping[str, Any]:
        """The driver's keys in a configuration that leads to this device, also while it is not started."""

    @abstractmethod
    def start(self) -> None:
        """Power on, in the same place as before; returns when it can be reached. It keeps nothing from before."""

    @abstractmethod
    def kill(self) -> None:
        """Power off, without a farewell on the wire; does no harm twice."""

    def silence(self, silent: bool) -> None:
        """Hang, or go on: says nothing, does nothing; what reaches it meanwhile is lost, as far as the bus can."""
        _unoffered("silence")

    def set_input(self, channel: str, value: float) -> None:
        """Let it measure `value` from now on."""
        _unoffered("set_input")

    def writes(self) -> Sequence[Mapping[str, float]]:
        """Every write that reached it since the last call, in order: outputs by name; its watchdog plays no part."""
        _unoffered("writes")

    def send(self, wire: bytes) -> None:
        """Put `wire` on the bus as if it had said it, in silence too.

        A device that speaks only when it is asked says it in place of its next answer.
        """
        _unoffered("send")

    def received(self) -> Sequence[bytes]:
        """Every unit that reached it since the last call."""
        _unoffered("received")

    def skip(self, count: int) -> None:
        """Let its counter go on, at once, by `count` readings of every input that it never sends."""
        _unoffered("skip")

    @property
    def counter_range(self) -> int | None:
        """How many values its counter has before it wraps; None if it has none."""
        return None

    def busy_s(self) -> Mapping[str, float]:
        """For how long each resource that the driver's ``loads`` names was in use since the last call.

        Counted from what was seen, in both directions, each unit with its worst case.
        """
        _unoffered("busy_s")


def _unoffered(hook: str) -> NoReturn:
    pytest.skip(f"the peer does not offer {hook}")
