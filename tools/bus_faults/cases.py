"""The faults of each bus that the campaign tries, and what must follow each; EtherCAT's: ``ethercat_cases.py``."""

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
LOST = "X-301"
"""The reference is missed after 500 ms, by the limits of a simulation."""

CAN = (
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

_STALE_MS = 300.0
"""Of Modbus: samples count as too old after 20 ms, and the axes coast on the feedforward for 50 ms."""


def half_open(bench: Any) -> None:
    """The device hangs, and has forgotten the connection when it goes on."""
    bench.device.order(inject="hang", for_s=0.05)
    time.sleep(0.03)
    bench.device.order(inject="disconnect")


MODBUS = (
    Case("1 % of the answers 40 ms late", inject("delay", ms=40, share=0.01), counted=("timeouts", "late")),
    Case("all answers 40 ms late", inject("delay", ms=40), CUT_OFF, _STALE_MS, ("late",)),
    Case("1 % of the answers lost", inject("drop", share=0.01), counted=("timeouts",)),
    Case("all answers split", inject("split", gap_ms=1)),
    Case("rubbish before 2 % of the answers", inject("garbage", share=0.02), counted=("bad_frames", "resyncs")),
    Case("2 % of the answers break off", inject("short", share=0.02), counted=("timeouts",)),
    Case("2 % of the answers with a wrong number", inject("transaction", share=0.02), counted=("late",)),
    Case("exception 6, busy, to 5 % of the requests", inject("exception", code=6, share=0.05), counted=("exceptions",)),
    Case("exception 2 to all requests", inject("exception", code=2), (LINK,), 100.0, said="exception 2"),
    Case("exception 4 to all requests", inject("exception", code=4), (LINK,), 100.0, said="exception 4"),
    Case("gateway hangs, connection open", inject("hang"), CUT_OFF, _STALE_MS, ("timeouts",), "3 times in a row"),
    Case("connection half open", half_open, (LINK,), 200.0, said="is gone"),
    Case("connection reset", inject("disconnect"), (LINK,), 100.0, said="is gone"),
    Case("port gone", inject("unplug"), (LINK,), 100.0, said="refused"),
    Case("counter frozen, values running", tell("stop_counter", for_s=0.6), CUT_OFF, _STALE_MS, ("repeated",)),
    Case("value frozen, counter running", tell("freeze", signal="strain_x", for_s=0.6), (STUCK,), _STALE_MS),
    Case("gauge says NaN: the largest code", tell("nan", signal="strain_x", for_s=0.6), (STRAIN,), _STALE_MS),
    Case("device restarted", tell("reboot", for_s=0.5), CUT_OFF, _STALE_MS),
    Case("worker killed", kill(signal.SIGKILL), CUT_OFF, 400.0, said="was killed by signal 9; started again"),
    Case("worker stopped for 0.5 s", kill(signal.SIGSTOP, 0.5), CUT_OFF, 400.0),
)

SERIAL = (
    Case("1 % of all frames lost", inject("drop", share=0.01), counted=("lost",)),
    Case("one wrong bit in 5 % of the frames", inject("flip", share=0.05), counted=("bad_frames",)),
    Case("rubbish before 5 % of the frames", inject("garbage", share=0.05), counted=("skipped_bytes",)),
    Case("5 % of the frames break off", inject("short", share=0.05), counted=("bad_frames",)),
    Case("all frames in two parts", inject("split", gap_ms=0.2)),
    Case("frames four at a time", inject("join", count=4)),
    Case("10 % of the frames doubled", inject("duplicate", share=0.1), counted=("not_fresh",)),
    Case("board silent, port there", inject("hang"), CUT_OFF, 150.0),
    Case("port unplugged", inject("unplug"), CUT_OFF, 150.0),
    Case("command frames lost, all", inject("drop", direction="received"), UNFOLLOWED, 150.0),
    Case("commands come back (echo)", inject("echo")),
    Case("counter frozen, values running", tell("stop_counter", for_s=0.6), CUT_OFF, 150.0),
    Case("value frozen, counter running", tell("freeze", signal="strain_x", for_s=0.6), (STUCK,), 150.0),
    Case("gauge says NaN: the largest code", tell("nan", signal="strain_x", for_s=0.6), (STRAIN,), 150.0),
    Case("board restarted", tell("reboot", for_s=0.5), CUT_OFF, 150.0),
    Case("worker killed", kill(signal.SIGKILL), CUT_OFF, 400.0, said="was killed by signal 9; started again"),
    Case("worker stopped for 0.5 s", kill(signal.SIGSTOP, 0.5), CUT_OFF, 400.0),
)

GCS = (
    Case("2 % of the replies missing", inject("drop", driver="piezo", share=0.02), counted=("missing_replies",)),
    Case("2 % of the replies 60 ms late", inject("delay", driver="piezo", ms=60, share=0.02)),
    Case("all replies missing", inject("drop", driver="piezo"), CUT_OFF, 300.0, ("missing_replies",)),
    Case("the controller refuses commands", inject("gcs_error", driver="piezo", code=5), CUT_OFF, 300.0, said="error"),
    Case("connection reset", inject("disconnect", driver="piezo"), CUT_OFF, 300.0),
    Case("port gone", inject("unplug", driver="piezo"), CUT_OFF, 300.0),
    Case("controller hangs, connection open", inject("hang", driver="piezo"), CUT_OFF, 300.0),
    Case("10 % of the datagrams lost", inject("drop", driver="tracker", share=0.1)),
    Case("10 % of the datagrams doubled", inject("duplicate", driver="tracker", share=0.1)),
    Case("neighbours swapped", inject("reorder", driver="tracker", share=0.1)),
    Case("datagrams from a stranger's address", inject("stranger", driver="tracker")),
    Case("tracker silent", inject("hang", driver="tracker", for_s=1.0), (LOST, LINK), 700.0, lasts_s=1.0),
    Case("value frozen", tell("freeze", signal="strain_x", for_s=1.0), (STUCK,), 700.0, lasts_s=1.0),
    Case("worker killed", kill(signal.SIGKILL), CUT_OFF, 400.0, said="was killed by signal 9; started again"),
)
