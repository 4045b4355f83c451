"""The faults of a bus that the campaign tries, and what must follow each."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Case:
    """One fault: `act` brings it about on a bench that tracks.

    `codes` are the faults one of which must be latched within `within_ms`; none means that the controller tracks on.
    `counted` names counters of the bus that must have grown, `said` what people must have been told.
    """

    name: str
    act: Callable[[Any], None]
    codes: tuple[str, ...] = ()
    within_ms: float = 0.0
    counted: tuple[str, ...] = ()
    said: str = ""
    lasts_s: float = 0.6
    note: str = ""


def inject(kind: str, for_s: float = 0.6, **more: Any) -> Callable[[Any], None]:
    """Disturb the line."""
    return lambda bench: bench.device.order(inject=kind, for_s=for_s, **more)


def tell(kind: str, **more: Any) -> Callable[[Any], None]:
    """Let the device misbehave."""
    return lambda bench: bench.device.order(device=kind, **more)


def kill(number: signal.Signals, then_s: float | None = None) -> Callable[[Any], None]:
    """Send the worker a signal; with `then_s`, let it go on after so long."""

    def act(bench: Any) -> None:
        worker = bench.worker
        os.kill(worker, number)
        if then_s is not None:
            time.sleep(then_s)
            os.kill(worker, signal.SIGCONT)

    return act


SENSORS, VOLTAGES = 257, 256
STRAIN, STAGE, LINK, STUCK, DISAGREE = "X-201", "X-202", "X-108", "X-204", "X-206"

# What must follow goes by what a fault does to the cell; whichever of the watches over that is the first is right.
UNHEARD = (STRAIN, STAGE, "X-106")
"""No fresh samples come: gauge or capacitive sensor unusable, or the enable line unknown."""
UNFOLLOWED = ("X-111", DISAGREE)
"""Commands don't arrive: the amplifier's watchdog trips, or the stage doesn't go where they were to take it."""
CUT_OFF = (*UNHEARD, *UNFOLLOWED, LINK)
"""Nothing goes either way."""

CASES = (
    Case("1 % of all frames dropped", inject("drop", share=0.01), counted=("lost",)),
    Case("10 % of all frames dropped", inject("drop", share=0.1), counted=("lost",)),
    Case("sensor frames dropped, all", inject("drop", share=1.0, identifier=SENSORS), UNHEARD, 100.0),
    Case("command frames dropped, all", inject("drop", share=1.0, identifier=VOLTAGES), UNFOLLOWED, 150.0),
    Case("all frames delayed by 0.5 ms", inject("delay", delay_s=0.0005)),
    Case("jitter of 0.5 ms", inject("delay", jitter_s=0.0005)),
    Case("30 % of the frames doubled", inject("duplicate", share=0.3), counted=("repeated",)),
    Case("sensor frames swapped", inject("reorder", share=0.3, identifier=SENSORS), counted=("out_of_order",)),
    Case("frames held for 100 ms, then a burst", inject("burst", hold_s=0.1), (*UNHEARD, *UNFOLLOWED), 150.0),
    Case("5 % of the frames corrupted, sent again", inject("corrupt", share=0.05)),
    Case("value frozen, counter running", tell("freeze", signal="strain_x", for_s=0.6), (STUCK, DISAGREE), 100.0),
    Case("counter frozen, values running", tell("stop_counter", for_s=0.6), UNHEARD, 100.0, ("repeated",)),
    Case("bus-off of the controller", inject("bus_off"), (LINK,), 100.0, said="bus-off"),
    Case("controller error-passive", inject("error_passive"), counted=("error_passive",)),
    Case("babbling node with identifier 0", inject("babble"), CUT_OFF, 150.0),
    Case(
        "transmit queue full (ENOBUFS)",
        inject("enobufs"),
        (LINK, *UNFOLLOWED),
        150.0,
        said="transmit buffer full",
    ),
    Case("device restarted", tell("reboot", for_s=0.5), (*UNHEARD, *UNFOLLOWED), 150.0),
    Case(
        "step of 50 um of the gauge",
        tell("offset", signal="strain_x", value=50.0, for_s=0.6),
        (STRAIN, DISAGREE),
        100.0,
    ),
    Case(
        "step of 50 um of the stage sensor", tell("offset", signal="stage_x", value=50.0, for_s=0.6), (DISAGREE,), 150.0
    ),
    Case(
        "gauge drifts by 20 um/s",
        tell("drift", signal="strain_x", per_s=20.0, for_s=0.6),
        note="the outer loop takes it up",
    ),
    Case(
        "stage sensor drifts by 20 um/s",
        tell("drift", signal="stage_x", per_s=20.0, for_s=0.6),
        note="nothing on the cell can tell: the stage goes with it",
    ),
    Case("gauge says NaN", tell("nan", signal="strain_x", for_s=0.6), (STRAIN,), 100.0),
    Case(
        "worker killed",
        kill(signal.SIGKILL),
        CUT_OFF,
        400.0,
        said="was killed by signal 9; started again",
    ),
    Case("worker stopped for 0.5 s", kill(signal.SIGSTOP, 0.5), CUT_OFF, 400.0),
)
