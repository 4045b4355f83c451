"""Frames a second that the driver `canbus` takes apart beside bare python-can, which only receives them.

Both read the same flood of frames of 15 signals each, in turns; whoever is slower is not the sender.
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

from micromanip.bus.driver import BusDriver, Inbox
from micromanip.bus.registry import driver_class
from micromanip.errors import CheckFailed

from .can_flood import BITRATE, DATA_BITRATE, SENSORS
from .plan import Plan
from .results import Result

FRAMES = 20_000
_PATIENCE_NS = 1_000_000_000


def run(plan: Plan) -> list[Result]:
    """Frames a second, the best of the pairs of each."""
    channel = f"flood-{os.getpid()}"
    driver = _driver(plan.configuration.parent, channel)
    with _flood(channel):
        pairs = []
        for pair in range(plan.pairs):
            plan.tell(f"can_frames: pair {pair + 1} of {plan.pairs}")
            pairs.append((_rate_hz(lambda: _taken(driver)), _rate_hz(lambda: _received(channel))))
    ours, bare = (max(rates) for rates in zip(*pairs, strict=True))
    return [Result.of("can_frames", ours, "frames/s", "python-can alone", bare)]


def _rate_hz(read: Callable[[], None]) -> float:
    begin = time.perf_counter()
    read()
    return FRAMES / (time.perf_counter() - begin)


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
