"""The faults of Modbus TCP that the campaign tries, on config/modbus.yaml, and what must follow each."""

from __future__ import annotations

import signal
import time
from typing import Any

from .cases import CUT_OFF, LINK, STRAIN, STUCK, Case, inject, kill, tell

STALE_MS = 300.0
"""Samples count as too old after 20 ms, and the axes coast on the feedforward for 50 ms."""


def half_open(bench: Any) -> None:
    """The device hangs, and has forgotten the connection when it goes on."""
    bench.device.order(inject="hang", for_s=0.05)
    time.sleep(0.03)
    bench.device.order(inject="disconnect")


CASES = (
    Case("1 % of the answers 40 ms late", inject("delay", ms=40, share=0.01), counted=("timeouts", "late")),
    Case("all answers 40 ms late", inject("delay", ms=40), CUT_OFF, STALE_MS, ("late",)),
    Case("1 % of the answers lost", inject("drop", share=0.01), counted=("timeouts",)),
    Case("all answers split", inject("split", gap_ms=1)),
    Case("rubbish before 2 % of the answers", inject("garbage", share=0.02), counted=("bad_frames", "resyncs")),
    Case("2 % of the answers break off", inject("short", share=0.02), counted=("timeouts",)),
    Case("2 % of the answers with a wrong number", inject("transaction", share=0.02), counted=("late",)),
    Case("exception 6, busy, to 5 % of the requests", inject("exception", code=6, share=0.05), counted=("exceptions",)),
    Case("exception 2 to all requests", inject("exception", code=2), (LINK,), 100.0, said="exception 2"),
    Case("exception 4 to all requests", inject("exception", code=4), (LINK,), 100.0, said="exception 4"),
    Case("gateway hangs, connection open", inject("hang"), CUT_OFF, STALE_MS, ("timeouts",), "3 times in a row"),
    Case("connection half open", half_open, (LINK,), 200.0, said="is gone"),
    Case("connection reset", inject("disconnect"), (LINK,), 100.0, said="is gone"),
    Case("port gone", inject("unplug"), (LINK,), 100.0, said="refused"),
    Case("counter frozen, values running", tell("stop_counter", for_s=0.6), CUT_OFF, STALE_MS, ("repeated",)),
    Case("value frozen, counter running", tell("freeze", signal="strain_x", for_s=0.6), (STUCK,), STALE_MS),
    Case("gauge says NaN: the largest code", tell("nan", signal="strain_x", for_s=0.6), (STRAIN,), STALE_MS),
    Case("device restarted", tell("reboot", for_s=0.5), CUT_OFF, STALE_MS),
    Case("worker killed", kill(signal.SIGKILL), CUT_OFF, 400.0, said="was killed by signal 9; started again"),
    Case("worker stopped for 0.5 s", kill(signal.SIGSTOP, 0.5), CUT_OFF, 400.0),
)
