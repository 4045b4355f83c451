"""The daemon of live experiments, in a process of its own: who asks for them computes meanwhile.

It stands in READY between two of them, its outputs at their park voltage, and ends where who asks is gone.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import CheckFailed, ConfigError, DeviceUnavailable, MicromanipError, PermissionDenied
from micromanip.host.arming import HostArming
from micromanip.host.controller import Controller
from micromanip.host.daemon import Options, serve
from micromanip.host.recording.recordings import Recordings
from micromanip.rt import mailbox as w
from micromanip.rt import states
from micromanip.rt.records import MAX_AXES
from micromanip.settings.check import Prepared, prepared
from micromanip.settings.compile.cell import compile_cell
from micromanip.settings.schema.model import Configuration

_LOOK_S, _BEYOND_S = 0.02, 0.1
"""Between two looks at the state; what an experiment tracks for beyond what was asked for."""


class Order(NamedTuple):
    """An experiment: track for `seconds`, armed as `configuration` says, play samples (n, axes), record to `file`."""

    configuration: Configuration
    samples: NDArray[np.float64]
    seconds: float
    file: Path


class _Asker:
    """Who asks. He computes between his orders and does not listen: a pipe that fills would hold up the host."""

    def __init__(self) -> None:
        self.pipe: Connection[Any, Any] = Connection(int(sys.argv[1]))
        self.listens = True

    def tell(self, kind: str, what: object) -> None:
        if self.listens:
            with contextlib.suppress(ConnectionError):
                self.pipe.send((kind, what))


def main() -> None:
    """Serve a cell: text, with its machining force or without, socket, room for samples; first order; then others."""
    asker = _Asker()
    source, process, socket, room, order = asker.pipe.recv()
    try:
        cell = prepared(source)
        drivers = cell.wiring.drivers
        kept = {name: driver if process else driver.without_process() for name, driver in drivers.items()}
        cell = _of(replace(cell, wiring=replace(cell.wiring, drivers=kept), samples=np.zeros((room, MAX_AXES))), order)
        options = Options(socket, 0.0, work=partial(_work, asker, cell, order))
        report = serve(cell, options, partial(asker.tell, "say"), partial(asker.tell, "show"))
        last: tuple[str, object] = "done", report["faults"]
    except MicromanipError as problem:
        kinds = (DeviceUnavailable, PermissionDenied, ConfigError)
        kind = next((kind for kind in kinds if isinstance(problem, kind)), CheckFailed)
        last = "raise", kind(str(problem))
    asker.listens = True
    asker.tell(*last)


def _of(cell: Prepared, order: Order) -> Prepared:
    parameters = compile_cell(order.configuration, cell.wiring)
    return replace(cell, configuration=order.configuration, parameters=parameters)


async def _work(
    asker: _Asker, cell: Prepared, order: Order | None, controller: Controller, recordings: Recordings,
    arming: HostArming, ends: Callable[[], bool],
) -> None:  # fmt: skip
    """Serve orders until there is none, it `ends`, or a fault has ended one: who has seen it is to begin anew."""
    while order is not None and await _play(_of(cell, order), order, controller, recordings, arming, ends):
        asker.tell("done", [])
        asker.listens = False
        await _while(lambda: not (asker.pipe.poll() or ends()))
        order = None
        if not ends():
            with contextlib.suppress(EOFError):
                order, asker.listens = asker.pipe.recv(), True


async def _play(
    cell: Prepared, order: Order, controller: Controller, recordings: Recordings, arming: HostArming,
    ends: Callable[[], bool],
) -> bool:  # fmt: skip
    """From READY to READY, recorded; False where a fault or the end comes first. CheckFailed where it can't be made."""
    table = controller.segments.sample_table()  # nobody reads it in READY
    table[: len(order.samples)], table[len(order.samples) :] = order.samples, order.samples[-1]
    await controller.apply(cell)
    await recordings.begin(order.file)
    await arming.arm(ends)
    await _while(lambda: controller.state == "ARMING" and not ends())
    last = controller.words[w.CYCLE] + (order.seconds + _BEYOND_S) * cell.configuration.loop.rate_hz
    await _while(lambda: controller.state == "TRACKING" and controller.words[w.CYCLE] < last and not ends())
    if ends() or controller.faults():
        return False
    await controller.command(states.DISARM)
    await _while(lambda: controller.state not in ("READY", "FAULT") and not ends())
    if ends() or controller.faults():
        return False
    await recordings.stop()
    return True


async def _while(condition: Callable[[], bool]) -> None:
    while condition():
        await asyncio.sleep(_LOOK_S)


if __name__ == "__main__":
    main()
