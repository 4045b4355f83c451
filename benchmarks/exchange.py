"""What the benchmarks of exchanges share: a partner in a process of its own, and rates of two that take turns."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from micromanip.bus.driver import BusDriver
from micromanip.bus.inbox import Inbox
from micromanip.bus.registry import driver_class
from micromanip.errors import CheckFailed

from .runner import Plan

_ROOT = Path(__file__).parent.parent
_PATIENCE_NS = 1_000_000_000


def python(*arguments: str, **more: Any) -> subprocess.Popen[str]:
    """A Python of our own kind, its standard output to be read."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [sys.executable, *arguments], stdout=subprocess.PIPE, cwd=_ROOT, env=environment, text=True, **more
    )


@contextmanager
def partner(kind: str, *arguments: object) -> Iterator[str]:
    """What ``benchmarks.partners KIND`` says when it is ready: where it is found, or why it cannot be."""
    with python("-m", "benchmarks.partners", kind, *map(str, arguments)) as process:
        try:
            assert process.stdout is not None
            said = process.stdout.readline().strip()
            if not said:
                raise CheckFailed(f"the process that plays the partner {kind} did not start")
            yield said
        finally:
            process.terminate()


def best(
    plan: Plan, name: str, count: int, plays: Sequence[Callable[[], None]], clock: Callable[[], float]
) -> list[float]:
    """Most of `count` a second by `clock` that each of `plays` came to, in turns."""
    pairs: list[list[float]] = []
    for pair in range(plan.pairs):
        plan.tell(f"{name}: pair {pair + 1} of {plan.pairs}")
        pairs.append([])
        for play in plays:
            begin = clock()
            play()
            pairs[-1].append(count / (clock() - begin))
    return [max(rates) for rates in zip(*pairs, strict=True)]


def driver_of(kind: str, options: Mapping[str, Any], folder: Path = _ROOT) -> BusDriver:
    """A driver with these options."""
    found = driver_class(kind)
    assert issubclass(found, BusDriver)
    return found(found.Options.model_validate(options), folder)


def receive(driver: BusDriver, frames: int) -> None:
    """As a worker does it: until all samples of the last of `frames` are there."""
    inbox, samples = Inbox(), frames * len(driver.inputs)
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


def perform(driver: BusDriver, count: int) -> None:
    """As a worker does it: task 0 `count` times, an answer each."""
    inbox, values = Inbox(), [0.0] * len(driver.outputs)
    driver.open()
    try:
        for _ in range(count):
            driver.perform(0, values, inbox)
            if not len(inbox):
                driver.receive(inbox, time.monotonic_ns() + _PATIENCE_NS)
            if len(inbox) != len(driver.inputs):
                raise CheckFailed("the driver got no answer")
            inbox.clear()
    finally:
        driver.close()
