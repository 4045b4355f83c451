"""Use of a CPU by the worker process of config/can.yaml, beside bare python-can that receives and sends as many frames.

The device is that of ``device simulate``, in a process of its own. There is no loop, so the outputs are at rest: the
worker sends and receives as in operation. Both take part in the same bus, in turns.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from micromanip.errors import CheckFailed
from micromanip.host.controller import Controller
from micromanip.host.workers import Workers
from micromanip.settings.check import Prepared, prepare

from .exchange import partner, python
from .runner import Plan, Result

_PAIRS, _SECONDS = 3, 4.0
_REPORT_S = 1.0
"""The worker says twice a second what it used."""


def run(plan: Plan) -> list[Result]:
    """Percent of one CPU; value and reference are medians over the pairs, the ratio is that of the pairs' ratios."""
    pairs = []
    with _played(plan.configuration.parent) as (configuration, channel):
        prepared = prepare(configuration)
        for pair in range(_PAIRS):
            plan.tell(f"can_worker: pair {pair + 1} of {_PAIRS}, {_SECONDS:g} s each")
            pairs.append((asyncio.run(_ours(prepared)), _bare(channel)))
    taken = np.array(pairs) * 100.0
    ours, bare = (float(value) for value in np.median(taken, axis=0))
    ratio = float(np.median(taken[:, 0] / taken[:, 1]))
    return [Result("can_worker", ours, "% of a CPU", "python-can alone", bare, ratio)]


async def _ours(prepared: Prepared) -> float:
    controller = Controller(prepared, Path())  # its shared memory, without a loop process
    try:
        async with Workers(prepared, controller.segments, controller.offsets, (), lambda _: None) as workers:
            await asyncio.sleep(_REPORT_S)
            begin, used_s = time.monotonic(), _used_s(workers)
            await asyncio.sleep(_SECONDS)
            return (_used_s(workers) - used_s) / (time.monotonic() - begin)
    finally:
        for descriptor in controller.segments.descriptors:
            os.close(descriptor)


def _used_s(workers: Workers) -> float:
    return sum(link["cpu_s"] for link in workers.report().values())


def _bare(channel: str) -> float:
    with partner("bare", channel, _SECONDS) as said:
        return float(said)


@contextmanager
def _played(examples: Path) -> Iterator[tuple[Path, str]]:
    """A copy of config/can.yaml on a channel of its own, and that channel, with the device at work."""
    channel = f"bench-{os.getpid()}"
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "can").symlink_to(examples / "can")
        configuration = Path(folder) / "can.yaml"
        example = (examples / "can.yaml").read_text()
        configuration.write_text(example.replace("channel: can0\n", f"channel: {channel}\n"))
        command = "import sys; from micromanip.cli.main import main; sys.exit(main())"
        with python("-c", command, "device", "simulate", str(configuration), stderr=subprocess.PIPE) as device:
            try:
                assert device.stderr is not None
                if not device.stderr.readline().startswith("READY"):
                    raise CheckFailed("device simulate did not start")
                yield configuration, channel
            finally:
                device.terminate()
