"""A bus as the loop sees it: a cyclic driver whose exchange is a look into the process image."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.rt.bus_image import IMAGE, OUTPUT_STATE, UNKNOWN

from .cyclic import CyclicDriver, Functions
from .driver import BusDriver, BusOptions, Channel


class BusBridge(CyclicDriver):
    """Stands for a bus driver that runs in a worker process."""

    Options: ClassVar[type[BaseModel]] = BusOptions

    def __init__(self, bus: BusDriver, options: BusOptions, silent_ns: int) -> None:
        """A worker that has been silent for `silent_ns` counts as a lost link."""
        self.bus, self._options, self._silent_ns = bus, options, silent_ns

    @property
    def simulated(self) -> bool:  # type: ignore[override]  # a class of its own says so once, a bus in its options
        return self._options.simulated

    @property
    def virtual(self) -> bool:
        return False

    @property
    def watchdog(self) -> str | None:  # type: ignore[override]
        return self.bus.watchdog or ("none needed: nothing real moves" if self.simulated else None)

    @property
    def device(self) -> str | None:
        return self.bus.device

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.bus.inputs)

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.bus.outputs)

    @property
    def slow_inputs(self) -> tuple[Channel, ...]:
        return tuple(self.bus.inputs)

    @property
    def slow_outputs(self) -> tuple[Channel, ...]:
        return tuple(self.bus.outputs)

    def context(self) -> NDArray[np.uint8]:
        image = np.zeros(1, IMAGE)
        image["inputs"], image["outputs"] = len(self.bus.inputs), len(self.bus.outputs)
        image["silent_ns"] = self._silent_ns
        image["words"][0][OUTPUT_STATE] = UNKNOWN
        return image.view(np.uint8)

    def functions(self) -> Functions:
        return bridge_functions()


def bridge_functions() -> Functions:
    """The four functions of every bus, in this process."""
    from . import bridge_functions as compiled  # loaded only where it is going to be called

    return Functions(
        compiled.open_c.address, compiled.exchange_c.address, compiled.safe_c.address, compiled.close_c.address
    )
