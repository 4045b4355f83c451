"""The contract of a cyclic driver: four C functions that the loop calls, and what they must keep.

    int32_t open(void *context)
    int32_t exchange(void *context, double *outputs, struct signal *inputs,
                     int64_t now_ns, int64_t periods)
    int32_t safe(void *context)
    int32_t close(void *context)

    struct signal { double value; int64_t time_ns; int64_t sequence; int64_t status; };

Each returns 0, or a code of the driver's own that ends in a fault. ``exchange`` is called once a
cycle: it writes the outputs decided in the cycle before and leaves the newest sample of each
input, adding one to ``sequence`` where the sample is fresh; ``time_ns`` is when it was taken
(CLOCK_MONOTONIC), ``status`` is 0 for a good one. ``periods`` is 1, or more after an overrun. It may
not allocate, block, or call Python. ``safe`` brings every output to its safe value; the host calls it in *its* own
process when the loop is dead, so all that it needs lives in the context.

A device that may be out of reach says so by what ``exchange`` returns: -1 (DOWN) while its link can't be used, -2
(TAKEN) while its outputs do not follow the loop. These are faults in use only, and end by themselves. What can't be
given yet, it may replace in ``outputs`` by what is given: then the axis goes no further in that direction.

``docs/write-a-driver.md`` has a complete example.
"""

from __future__ import annotations

import ctypes
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .driver import Channel, Driver, Load
from .safe_state import SafeOutput

CONTEXT_C = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)
"""A driver's open, safe or close."""
EXCHANGE_C = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64
)


def call_context(function: int, context: int) -> int:
    """Call a driver's open, safe or close (addresses) from Python; its return code."""
    return int(CONTEXT_C(function)(context))


@dataclass(frozen=True)
class Functions:
    """Addresses of a driver's C functions, valid in this process."""

    open: int
    exchange: int
    safe: int
    close: int


@dataclass(frozen=True)
class Wire:
    """A wire that the loop itself serves: whether the device answers, and what its outputs do.

    `outputs` is one of ``OUTPUT_NAMES`` of ``rt/bus_image.py``, `given` what each output was given last, at `sent_ns`
    (CLOCK_MONOTONIC, 0 for never); `links` is how often the device began to answer.
    """

    up: bool
    outputs: str
    given: tuple[float, ...]
    sent_ns: int
    links: int


class CyclicDriver(Driver):
    """A driver whose ``exchange`` runs inside the loop."""

    simulated: ClassVar[bool] = False
    """True where nothing real moves: only then is `arm_on_start` accepted."""

    watchdog: ClassVar[str | None] = None
    """The hardware watchdog that covers a dead loop, in a few words; None if there is none."""

    @property
    def virtual(self) -> bool:
        """True where the cell can run in virtual time: all that answers is computed in ``exchange``."""
        return self.simulated

    @property
    def device(self) -> str | None:
        """One that is not simulated and does not say counts as the owner of one device of its kind."""
        return None if self.simulated else type(self).__name__

    @property
    def devices(self) -> tuple[str, ...]:
        """All that it owns: the device, and what else nobody may have beside it; each is locked."""
        return () if self.device is None else (self.device,)

    @abstractmethod
    def __init__(self, options: Any, period_ns: int) -> None:
        """`options` is a validated ``Options``; raises ConfigError for what only the driver can know."""

    def check_files(self, folder: Path) -> None:
        """Hold the files that the options name, seen from `folder`, that of the configuration, against the options.

        Where a configuration is checked; raises ConfigError.
        """

    @property
    @abstractmethod
    def inputs(self) -> tuple[str, ...]:
        """Names of the input channels, in the order in which ``exchange`` fills them."""

    @property
    @abstractmethod
    def outputs(self) -> tuple[str, ...]:
        """Names of the output channels, in the order in which ``exchange`` takes them."""

    @property
    def slow_inputs(self) -> tuple[Channel, ...]:
        """Rate and latency of the inputs that are not fresh, of this very moment, in every cycle."""
        return ()

    @property
    def slow_outputs(self) -> tuple[Channel, ...]:
        """Rate and latency of the outputs that are not in force in the cycle in which they are written.

        One whose `safe` the driver itself leads to must be among them: `check` sees that it is the output's `park_V`.
        """
        return ()

    @property
    def steers(self) -> bool:
        """Whether the loop's deadlines follow a clock of this driver's: ``steering_ns``. At most one driver's do."""
        return False

    def steering_ns(self, context: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Where in the context ``exchange`` writes, in each cycle, by how much the next deadline comes later: (1,).

        The loop takes a hundredth of a period at most. Asked where it ``steers``.
        """
        raise NotImplementedError

    def loads(self) -> Sequence[Load]:
        """What the loop's rate costs on a wire, where there is one."""
        return ()

    @abstractmethod
    def context(self) -> NDArray[np.uint8]:
        """First contents of the context, a block of bytes that the loop and the host share; no pointers in it."""

    def adopt(self, context: NDArray[np.uint8], outputs: Sequence[SafeOutput]) -> None:
        """Take over the limits of the outputs, in the order of `outputs`, into the context.

        The host tells them before the loop begins and again when they have changed, which they do at rest only. The
        loop keeps to them by itself: they are for a driver whose commands may be lost on the way.
        """

    def begin(self, context: NDArray[np.uint8]) -> None:
        """Get ready in Python what ``open`` needs: called by the process that calls it, with its context, just before.

        May block for some seconds; must not move anything. Raises BusError, with a message for whoever starts the cell.
        """

    def statistics(self, context: NDArray[np.uint8]) -> Mapping[str, int]:  # noqa: ARG002 (what a subclass may count)
        """Counters of its own, out of the context, while the loop runs."""
        return {}

    def missing(self, context: NDArray[np.uint8]) -> NDArray[np.int64] | None:  # noqa: ARG002 (most can't tell)
        """Samples of each input that are known never to have come, since the loop saw its first one (inputs,).

        None where each gap in a ``sequence`` is one of those.
        """
        return None

    def wire(self, context: NDArray[np.uint8]) -> Wire | None:  # noqa: ARG002 (most have none)
        """Where its wire stands, out of the context, while the loop runs; None where it has none."""
        return None

    def without_process(self) -> CyclicDriver:
        """The driver for an experiment without machining: a simulation leaves its process force out."""
        return self

    @abstractmethod
    def functions(self) -> Functions:
        """Addresses of the four functions in the calling process; compiles or loads them if need be."""

    def safe_in_host(self) -> Callable[[NDArray[np.uint8]], int]:
        """``safe``, loaded: the host calls it with the context once the loop has died, and gets the code.

        It must neither take time nor fail by then. A driver that is compiled by numba may do it in Python, so that the
        host need not load a compiler.
        """
        safe = self.functions().safe
        return lambda context: call_context(safe, context.ctypes.data)
