"""What a simulated node needs of the bus that it is on, whatever carries its frames."""

from __future__ import annotations

from typing import Protocol

from .frame import Frame
from .port import Node


class Bus(Protocol):
    """The hub of the test bus, or an interface of python-can."""

    def attach(self, node: Node) -> None:
        """Let `node` take part."""

    def detach(self, node: Node) -> None:
        """Take `node` off the bus: it was switched off."""

    def send(self, node: Node, frame: Frame, time_ns: int | None = None) -> bool:
        """Queue a frame that was ready at `time_ns`, None for now; False where it was lost."""
