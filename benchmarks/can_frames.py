"""Frames a second that the driver `canbus` takes apart beside bare python-can, which only receives them.

All read the same flood of frames of 15 signals each, in turns; whoever is slower is not the sender: `can_frames` is the
driver's Python, `can_frames_compiled` the compiled loop of its worker, samples handed over and all.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import numpy as np

from micromanip.bus.driver import BusDriver
from micromanip.bus.image import ProcessImage
from micromanip.bus.inbox import Inbox
from micromanip.bus.output_writer import OutputWriter
from micromanip.bus.registry import driver_class
from micromanip.bus.safe_state import SafeState
from micromanip.bus.schedule import Schedule
from micromanip.bus.steady import SteadyService
from micromanip.errors import CheckFailed
from micromanip.rt.bus_image import IMAGE

from .can_flood import BITRATE, DATA_BITRATE, SENSORS
from .plan import Plan
from .results import Result

FRAMES = 60_000
_STAY_NS, _LOOK_NS = 5_000_000, 1_000_000
_PATIENCE_NS = 1_000_000_000
_SLOWEST_NS = 1_000_000


def run(plan: Plan) -> list[Result]:
    """Frames a second of CPU, the best of the pairs of each: what else the machine does takes no part in that."""
    channel = f"flood-{os.getpid()}"
    driver = _driver(plan.configuration.parent, channel)
    with _flood(channel):
        pairs = []
        for pair in range(plan.pairs):
            plan.tell(f"can_frames: pair {pair + 1} of {plan.pairs}")
            reads = (lambda: _taken(driver), lambda: _served(driver), lambda: _received(channel))
            pairs.append([_rate_hz(read) for read in reads])
    python, compiled, bare = (max(rates) for rates in zip(*pairs, strict=True))
    return [
        Result.of("can_frames", python, "frames/s", "python-can alone", bare),
        Result.of("can_frames_compiled", compiled, "frames/s", "python-can alone", bare),
    ]


def _rate_hz(read: Callable[[], None]) -> float:
    begin = time.process_time()
    read()
    return FRAMES / (time.process_time() - begin)


def _received(channel: str) -> None:
    with can.Bus(channel, "micromanip", ignore_config=True, fd=True, bitrate=BITRATE, data_bitrate=DATA_BITRATE) as bus:
        for _ in range(FRAMES):
            if bus.recv(_PATIENCE_NS * 1e-9) is None:
                raise CheckFailed("frames of the flood are missing")


def _taken(driver: BusDriver) -> None:
    """As the worker does it: until all samples of the last frame are there."""
    inbox, samples = Inbox(), FRAMES * len(driver.inputs)
    driver.open()
    try:
        while samples > 0:
            driver.receive(inbox, time.monotonic_ns() + _PATIENCE_NS)
            if not len(inbox):
                raise CheckFailed("samples of the flood are missing")
            samples -= len(inbox)
            inbox.clear()
    finally:
        driver.close()


def _served(driver: BusDriver) -> None:
    """As the worker's compiled loop does it, in stays of some milliseconds."""
    record = np.zeros(1, IMAGE)
    record["inputs"] = len(driver.inputs)
    steady = SteadyService.of(driver, ProcessImage(record))
    if steady is None:
        raise CheckFailed("the driver has no compiled functions")
    safe, schedule = SafeState([], [], 1.0, 1_000_000_000), Schedule((), 0)
    writer, samples = OutputWriter(driver, safe, lambda _: None), FRAMES * len(driver.inputs)
    driver.open()
    try:
        begin_ns = time.monotonic_ns()
        while samples > 0:
            now_ns = time.monotonic_ns()
            if now_ns - begin_ns > FRAMES * _SLOWEST_NS:
                raise CheckFailed("samples of the flood are missing")
            steady.begin()
            samples -= steady.serve(safe, writer, schedule, None, _LOOK_NS, now_ns + _STAY_NS).received
    finally:
        driver.close()


def _driver(folder: Path, channel: str) -> BusDriver:
    kind = driver_class("canbus")
    assert issubclass(kind, BusDriver)
    options = kind.Options.model_validate(
        {
            "interface": "micromanip",
            "channel": channel,
            "bitrate": BITRATE,
            "data_bitrate": DATA_BITRATE,
            "database": "can/manipulator.dbc",
            "receive": {"Sensors": {"rate_hz": 2000.0, "counter": "Count", "status": {"signal": "Status"}}},
            "silence_ms": None,
        }
    )
    driver = kind(options, folder)
    assert any(channel.name == "Sensors.strain_x" for channel in driver.inputs), f"{SENSORS:#x} is no longer Sensors"
    return driver


@contextmanager
def _flood(channel: str) -> Iterator[None]:
    command = [sys.executable, "-m", "benchmarks.can_flood", channel, str(FRAMES)]
    root = Path(__file__).parent.parent
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=root, env=environment) as process:
        try:
            assert process.stdout is not None
            if process.stdout.readline().strip() != b"ready":
                raise CheckFailed("the process that floods the bus did not start")
            yield
        finally:
            process.kill()
