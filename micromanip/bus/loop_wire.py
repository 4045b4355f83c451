"""A cyclic driver that serves a wire in the loop itself, through the gate: what is the same on every wire."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from micromanip.errors import ConfigError
from micromanip.rt.bus_image import OUTPUT_NAMES, RESTING
from micromanip.rt.io.gate import SWITCH, VOLTAGE
from micromanip.rt.io.link_gate import ANSWERS, QUIET
from micromanip.rt.records import MAX_OUTPUTS

from .cyclic import CyclicDriver, Wire
from .driver import Channel
from .number_options import Commanded, Section
from .safe_state import SafeOutput
from .watchdog import Milliseconds, Watchdog


class LoopOutput(Commanded):
    """A value sent to the device in every cycle."""

    switch: bool = Field(
        default=False,
        strict=True,
        description="Digital output: need not be at rest before the outputs follow the loop again.",
    )


class LoopWireOptions(Section):
    """Keys of every driver in the loop."""

    simulated: bool = Field(
        default=False,
        strict=True,
        description="The device is `micromanip device simulate`: nothing real moves. Refused for another machine or a "
        "real network interface.",
    )
    silence_ms: Milliseconds = Field(
        default=5.0, description="Longest time without a complete answer; then the link is lost."
    )
    watchdog: Watchdog | None = Field(default=None, description="Required where there are outputs.")
    wait_us: Annotated[float, Field(strict=True, ge=0, le=1000)] = Field(
        default=0.0,
        description="Spin for this cycle's answer until this long after the deadline; 0: use the previous cycle's.",
    )


_UNSAFE = 1


_MOST_OF_A_CYCLE = 0.8
"""The loop waits for the wire at most for so much of its cycle: the laws need the rest."""


class LoopWire(CyclicDriver):
    """Its options are ``LoopWireOptions``, and what is its own."""

    CONTEXT: ClassVar[np.dtype[Any]]
    """Record with the fields of ``WIRE`` (``rt/io/context.py``)."""
    COUNTERS: ClassVar[tuple[str, ...]]
    """Its fields that are counters for ``statistics``."""
    BAD: ClassVar[tuple[str, ...]]
    """Those of them that count as errors."""

    options: LoopWireOptions

    def __init__(self, options: LoopWireOptions, period_ns: int, fields: Mapping[str, LoopOutput], key: str) -> None:
        """`fields` are the outputs by name, in the order in which they are sent; `key` is where they stand.

        Raises ConfigError for outputs that nothing would bring to rest, or before the loop knows that the link is lost,
        and for a wait that leaves no time for the laws.
        """
        self.options, self.period_ns, self._fields = options, period_ns, fields
        self.simulated = options.simulated  # type: ignore[misc]
        self.watchdog = None if options.watchdog is None else options.watchdog.words  # type: ignore[misc]
        if fields and options.watchdog is None:
            raise ConfigError(
                "watchdog must be given: it brings the outputs to rest when the loop has died; this driver can't move "
                "a device that has none"
            )
        if options.watchdog is not None and (options.watchdog.ms is None or not options.watchdog.leads_to_rest):
            raise ConfigError(
                "watchdog: the device must go to rest after `ms`, and after_power_on must be rest: silence is the one "
                "way to rest in the loop; a device that does otherwise needs a bus driver"
            )
        if options.watchdog is not None and options.silence_ms > 0.5 * (options.watchdog.ms or 0.0):
            raise ConfigError(
                f"silence_ms: {options.silence_ms:g} ms must be at most half of the watchdog's {options.watchdog.ms:g} "
                "ms: the loop must know that the link is lost before the device moves by itself"
            )
        self.wait_us: float = options.wait_us
        if self.wait_us * 1e3 > _MOST_OF_A_CYCLE * period_ns:
            raise ConfigError(
                f"wait_us: {self.wait_us:g} us is more than {100 * _MOST_OF_A_CYCLE:g} % of the cycle of "
                f"{1e-3 * period_ns:g} us: the laws need the rest"
            )
        if len(fields) > MAX_OUTPUTS:
            raise ConfigError(f"{key}: {len(fields)} outputs, at most {MAX_OUTPUTS} are possible")

    @property
    def virtual(self) -> bool:
        return False

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(self._fields)

    @property
    def slow_outputs(self) -> tuple[Channel, ...]:
        return tuple(Channel(name, 1e9 / self.period_ns, 0.0, field.safe) for name, field in self._fields.items())

    @property
    def silent_cycles(self) -> int:
        """So many in a row without an answer, and the link is lost."""
        return math.ceil(self.options.silence_ms * 1e6 / self.period_ns)

    @property
    def age_s(self) -> float:
        """How old what comes back is: the answer of one cycle is taken in the next, or spun for."""
        return 0.0 if self.wait_us > 0 else self.period_ns * 1e-9

    def context(self) -> NDArray[np.uint8]:
        context, watchdog = np.zeros(1, self.CONTEXT), self.options.watchdog
        context[0]["socket"]["descriptor"] = -1
        gate = context[0]["gate"]
        gate["state"], gate["outputs"] = RESTING, len(self._fields)
        gate["silent_cycles"] = gate["patient_cycles"] = self.silent_cycles
        gate["watchdog_ns"] = np.iinfo(np.int64).max if watchdog is None else round(watchdog.begins_ns)
        gate["still_ns"] = 0 if watchdog is None else watchdog.still_ns
        for i, field in enumerate(self._fields.values()):
            gate["safe"][i] = gate["last"][i] = field.safe
            gate["kind"][i] = SWITCH if field.switch else VOLTAGE
            gate["step"][i] = math.inf if field.switch else 0.0  # until the limits are adopted
        context[0]["wait_ns"] = round(1e3 * self.wait_us)
        self.fill(context[0])
        return context.view(np.uint8)

    @abstractmethod
    def fill(self, c: Any) -> None:
        """Put into a context what is the driver's own: the tables of both frames, the counts, the device's clock."""

    @abstractmethod
    def is_at_rest(self) -> bool:
        """Whether the device, which its watchdog has brought to rest, is there and at rest. May raise BusError."""

    def adopt(self, context: NDArray[np.uint8], outputs: Sequence[SafeOutput]) -> None:
        gate = self.record(context)["gate"]
        for i, output in enumerate(outputs):
            if gate["kind"][i] == VOLTAGE:
                gate["step"][i] = output.slew_V_per_s * self.period_ns * 1e-9

    def safe_in_host(self) -> Callable[[NDArray[np.uint8]], int]:
        return self._made_safe

    def statistics(self, context: NDArray[np.uint8]) -> Mapping[str, int]:
        c = self.record(context)
        counted = {name: int(c["counted"][name]) for name in ("lost", "doubled", "late", "restarts")}
        counts = {name: int(c[name]) for name in self.COUNTERS}
        counts |= {name: int(c["gate"][name]) for name in ("unanswered", "refused_values", "held_back", "losses")}
        totals = {"performed": int(c["gate"]["sent_count"]), "errors": sum(counts[name] for name in self.BAD)}
        return {**counts, **counted, "clock_steps": int(c["clock"]["steps"]), **totals}

    def missing(self, context: NDArray[np.uint8]) -> NDArray[np.int64]:
        found: NDArray[np.int64] = self.record(context)["samples"]["lost"][: len(self.inputs)].copy()
        return found

    def wire(self, context: NDArray[np.uint8]) -> Wire:
        gate = self.record(context)["gate"]
        sent_ns = int(gate["sent_ns"])
        silent = time.monotonic_ns() - sent_ns > int(gate["watchdog_ns"])  # no loop
        state = QUIET if silent else int(gate["state"])
        given = tuple(float(value) for value in gate["last"][: len(self._fields)])
        up = state != QUIET and int(gate["answers"]) >= ANSWERS
        return Wire(up, OUTPUT_NAMES[state], given, sent_ns, int(gate["begun"]))

    def record(self, context: NDArray[np.uint8]) -> Any:
        """The context as its record."""
        return context.view(self.CONTEXT)[0]

    def _made_safe(self, context: NDArray[np.uint8]) -> int:
        """Its watchdog has brought it to rest by then; whether it is there, and takes that."""
        gate = self.record(context)["gate"]  # nothing may be sent meanwhile
        time.sleep(max(0, int(gate["sent_ns"]) + int(gate["still_ns"]) - time.monotonic_ns()) * 1e-9)
        return 0 if self.is_at_rest() else _UNSAFE
