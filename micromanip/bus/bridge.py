"""A bus as the loop sees it: a cyclic driver whose exchange is a look into the process image."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from micromanip.rt.bus_image import IMAGE, OUTPUT_STATE, RESTING, SENT_NS, UNKNOWN
from micromanip.rt.mailbox import ask

from .cyclic import CyclicDriver, Functions
from .driver import BusDriver, BusOptions, Channel, Load

UNSAFE = 1
"""Of ``safe_in_host``: the worker did not bring its outputs to rest in time."""
PATIENCE_NS, _STEP_S = 5_000_000_000, 2e-3
PERIODS = 4
"""An output waits for its device where its turn has not come for more than so many periods; a bus that is slow for
long, and no more than that, is not waited for."""


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
    def files(self) -> Sequence[Path]:
        return self.bus.files

    @property
    def device(self) -> str | None:
        return self.bus.device

    @property
    def real_because(self) -> str | None:
        return self.bus.real_because

    def loads(self) -> Sequence[Load]:
        return self.bus.loads()

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
        for i, channel in enumerate(self.bus.outputs):
            image["patience_ns"][0][i] = round(PERIODS * 1e9 / channel.rate_hz)
        return image.view(np.uint8)

    def missing(self, context: NDArray[np.uint8]) -> NDArray[np.int64]:
        image = context.view(IMAGE)[0]
        found: NDArray[np.int64] = image["missing"] - image["missing_before"]
        return found[: len(self.inputs)]

    def functions(self) -> Functions:
        return bridge_functions()

    def safe_in_host(self) -> Callable[[NDArray[np.uint8]], int]:
        return wait_for_rest


def wait_for_rest(context: NDArray[np.uint8]) -> int:
    """Wait until the worker, which has noticed by itself that the loop is dead, has brought its outputs to rest.

    Given up, UNSAFE, when for a while the device has taken nothing: a worker that died is started anew meanwhile.
    """
    words = context.view(IMAGE)[0]["words"]
    begin_ns = time.monotonic_ns()
    while ask(words, OUTPUT_STATE) != RESTING:
        if time.monotonic_ns() - max(begin_ns, ask(words, SENT_NS)) > PATIENCE_NS:
            return UNSAFE
        time.sleep(_STEP_S)
    return 0


def bridge_functions() -> Functions:
    """The four functions of every bus, in this process."""
    from . import bridge_functions as compiled  # loaded only where it is going to be called

    return Functions(*compiled.ENTRIES.addresses)
