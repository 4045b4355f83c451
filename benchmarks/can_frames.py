"""Frames a second that the driver `canbus` takes apart beside bare python-can, which only receives them.

All read the same flood of frames of 15 signals each, in turns; whoever is slower is not the sender: `can_frames` is the
driver's Python, `can_frames_compiled` the compiled loop of its worker, samples handed over and all.
"""

from __future__ import annotations

import os
import time

import can
import numpy as np

from micromanip.bus.driver import BusDriver
from micromanip.bus.image import ProcessImage
from micromanip.bus.safe_state import SafeState
from micromanip.bus.schedule import Schedule
from micromanip.bus.steady import SteadyService
from micromanip.errors import CheckFailed
from micromanip.rt.bus_image import IMAGE

from .exchange import best, driver_of, partner, receive
from .partners import BITRATE, DATA_BITRATE
from .runner import Plan, Result

FRAMES = 60_000
_STAY_NS, _LOOK_NS, _SLOWEST_NS = 5_000_000, 1_000_000, 1_000_000


def run(plan: Plan) -> list[Result]:
    """Frames a second of CPU, the best of the pairs of each: what else the machine does takes no part in that."""
    channel = f"flood-{os.getpid()}"
    options = {
        "interface": "micromanip",
        "channel": channel,
        "bitrate": BITRATE,
        "data_bitrate": DATA_BITRATE,
        "database": "can/manipulator.dbc",
        "receive": {"Sensors": {"rate_hz": 2000.0, "counter": "Count", "status": {"signal": "Status"}}},
        "silence_ms": None,
    }
    driver = driver_of("canbus", options, plan.configuration.parent)
    with partner("can", channel, FRAMES):
        plays = (lambda: receive(driver, FRAMES), lambda: _serve(driver), lambda: _receive(channel))
        python, compiled, bare = best(plan, "can_frames", FRAMES, plays, time.process_time)
    return [
        Result.of("can_frames", python, "frames/s", "python-can alone", bare),
        Result.of("can_frames_compiled", compiled, "frames/s", "python-can alone", bare),
    ]


def _receive(channel: str) -> None:
    with can.Bus(channel, "micromanip", ignore_config=True, fd=True, bitrate=BITRATE, data_bitrate=DATA_BITRATE) as bus:
        for _ in range(FRAMES):
            if bus.recv(1.0) is None:
                raise CheckFailed("frames of the flood are missing")


def _serve(driver: BusDriver) -> None:
    """As the worker's compiled loop does it, in stays of some milliseconds."""
    record = np.zeros(1, IMAGE)
    record["inputs"] = len(driver.inputs)
    steady = SteadyService.of(driver, ProcessImage(record))
    if steady is None:
        raise CheckFailed("the driver has no compiled functions")
    safe, schedule = SafeState([], [], 1.0, 1_000_000_000), Schedule((), 0)
    samples = FRAMES * len(driver.inputs)
    driver.open()
    try:
        begin_ns = time.monotonic_ns()
        while samples > 0:
            now_ns = time.monotonic_ns()
            if now_ns - begin_ns > FRAMES * _SLOWEST_NS:
                raise CheckFailed("samples of the flood are missing")
            steady.begin()
            samples -= steady.serve(safe, schedule, None, _LOOK_NS, now_ns + _STAY_NS)[0]["received"]
    finally:
        driver.close()
