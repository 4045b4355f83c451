"""The devices of a driver `canopen`: a node for each that the configuration names, with the bus that they are on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from micromanip.errors import MicromanipError, UsageError
from micromanip.sim.canbus.canopen_node import CanOpenNode

from .amplifier import Amplifier
from .can_bus import CanBus, read_bus_settings
from .cell import PlayedCell
from .plain_options import Place, section, value
from .played import PlayedDevice, Surroundings
from .wires import Wires, wires_of


class PlayedCanOpen:
    """Nodes that boot, obey NMT and watch their commander by themselves."""

    def __init__(self, bus: CanBus, nodes: dict[str, CanOpenNode], signals: list[str], pdos: tuple[int, int]) -> None:
        self._bus, self._nodes, self._pdos = bus, nodes, pdos
        self.signals = signals
        self.messages: list[str] = []  # a PDO has no counter; to silence one, drop its identifier on the bus

    @property
    def ready(self) -> str:
        return f"{self._bus.ready(*self._pdos)}, nodes {', '.join(self._nodes)}"

    def start(self, now_ns: int) -> None:
        self._bus.start(now_ns)

    def stop_counter(self, message: str, for_s: float | None) -> None:  # noqa: ARG002
        raise UsageError(f"{message} has no counter")

    def silence(self, message: str, for_s: float | None) -> None:  # noqa: ARG002
        raise UsageError(f"{message} can't be silenced by name; inject a drop of its identifier")
