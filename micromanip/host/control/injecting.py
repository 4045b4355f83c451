"""One injection into one loop at a time: begun, followed in the telemetry ring, and ended whatever happens.

The loop itself lets it begin and end softly, and ends it at once where the axis neither tracks nor is held. The host
takes it back where nobody asks for it any more, and puts the parameters in force again as they were.
"""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.control.injection import Injection
from micromanip.errors import CheckFailed, MicromanipError, UsageError, require_axis
from micromanip.replies import Injected, Response
from micromanip.rt.states import HOLDING, STATE_NAMES, TRACKING
from micromanip.settings.excitation_plan import COLUMNS, plan_excitation
from micromanip.settings.wiring.timing import feedback_path
from micromanip.virtual.own_time import at_own_time

from ..controller import Controller
from ..shared_memory import RingReader
from .moving import Lease

_LOOK_S, _LEASE_S = 0.05, 1.0
"""How often the ring is read; an injection that nobody asks about for so long is taken back."""
_ALLOWED = (STATE_NAMES[TRACKING], STATE_NAMES[HOLDING])


class Injecting:
    """The injection that runs, or the last one."""

    def __init__(self, controller: Controller) -> None:
        """None yet."""
        self._controller = controller
        self._number, self._progress, self._lease = 0, 0.0, Lease(_LEASE_S, _LOOK_S)
        self._task: asyncio.Task[Response] | None = None
        self._what = ""

    def require_none(self) -> None:
        """Raise CheckFailed while one runs."""
        if self._task is not None and not self._task.done():
            raise CheckFailed(f"nothing was changed: {self._what} is being measured, {100 * self._progress:.0f} % done")

    async def begin(self, axis: str, loop: str, amplitude_um: float, seed: int) -> Injected:
        """Let the loop inject; UsageError or CheckFailed says why not. The caller lets nobody else change anything."""
        self.require_none()
        prepared, state = self._controller.prepared, self._controller.state
        configuration = prepared.configuration
        require_axis(axis, configuration.axes)
        path = feedback_path(configuration, prepared.wiring, axis)
        wave = await asyncio.to_thread(plan_excitation, configuration, path, axis, loop, amplitude_um, seed)
        if state not in _ALLOWED:
            raise CheckFailed(
                f"sensitivity refused: the state is {state}; a loop is measured while TRACKING or HOLDING"
            )
        index = list(configuration.axes).index(axis)
        self._require_room(index, axis, wave)
        self._number, self._progress = self._number + 1, 0.0
        self._what = f"the sensitivity of axis {axis}, {loop} loop,"
        reader = RingReader(self._controller.ring)
        async with self._controller.commanding():
            await self._put(wave, index)
        self._lease = Lease(_LEASE_S, _LOOK_S)
        self._task = asyncio.create_task(self._follow(wave, axis, loop, index, reader, state))
        return Injected(
            number=self._number,
            seconds=wave.cycles / wave.rate_hz,
            configuration=configuration.model_dump(mode="json"),
            path=asdict(path),
            simulated=all(driver.simulated for driver in prepared.wiring.drivers.values()),
        )

    def look(self, number: int) -> Response:
        """Where injection `number` stands, with its spectra once it is done; CheckFailed where it was ended early."""
        if number != self._number or self._task is None:
            raise UsageError(f"sensitivity: there is no measurement {number}, the last is {self._number}")
        self._lease.renew()
        if self._task.done():
            return self._task.result()
        return Response(
            number=number, done=False, progress=round(self._progress, 3), frequency_Hz=[], input=[], output=[]
        )

    def _require_room(self, index: int, axis: str, wave: Injection) -> None:
        now_um = float(self._controller.status["state"][0]["axis"][index]["setpoint_um"])
        low_um, high_um = self._controller.prepared.configuration.axes[axis].setpoint.range_um
        if not low_um + wave.peak <= now_um <= high_um - wave.peak:
            raise CheckFailed(
                f"sensitivity refused: the set-point of axis {axis} is {now_um:.1f} um, too near to the end of its "
                f"range {low_um:g} to {high_um:g} um for a swing of {wave.peak:.1f} um"
            )

    async def _put(self, wave: Injection | None, index: int, *, stop: bool = False) -> None:
        """Parameters as they are, with the injection, or without."""
        parameters = self._controller.prepared.parameters
        if wave is not None:
            parameters = parameters.copy()
            wave.fill(parameters[0]["axis"][index]["excitation"], self._number, stop=stop)
        await self._controller.inject(parameters)

    async def _follow(
        self, wave: Injection, axis: str, loop: str, index: int, reader: RingReader, state: str
    ) -> Response:
        try:
            rows = await self._watch(wave, axis, index, reader, state)
        except MicromanipError:
            with contextlib.suppress(MicromanipError):
                await self._put(wave, index, stop=True)
                await asyncio.sleep(1.5 * wave.fade_cycles / wave.rate_hz)
            raise
        finally:
            with contextlib.suppress(MicromanipError):
                await self._put(None, index)
        return await asyncio.to_thread(self._spectra, wave, loop, index, rows)

    async def _watch(self, wave: Injection, axis: str, index: int, reader: RingReader, state: str) -> NDArray[Any]:
        """The rows of the injection, from its first cycle on."""
        kept: list[NDArray[Any]] = []
        a = self._controller.status["state"][0]["axis"][index]["excitation"]
        begun = int(a["begun_cycle"])
        while True:
            await asyncio.sleep(_LOOK_S)
            while len(rows := reader.read()):
                kept.append(rows[rows["cycle"] >= begun])
            last = int(kept[-1]["cycle"][-1]) if kept and len(kept[-1]) else begun
            self._progress = min(1.0, (last - begun) / wave.cycles)
            if last - begun >= wave.cycles:
                return np.concatenate(kept)
            now = self._controller.state
            if now != state:
                raise CheckFailed(f"the measurement was ended: the state is {now}, it began while {state}")
            if a["over"]:
                raise CheckFailed(f"the measurement was ended by the loop: a sensor of axis {axis} is not usable")
            if self._lease.ran_out():
                raise CheckFailed(f"the measurement was ended: nobody has asked for it for {self._lease.seconds:g} s")

    def _spectra(self, wave: Injection, loop: str, index: int, rows: NDArray[Any]) -> Response:
        prepared = self._controller.prepared
        moved = at_own_time(rows, prepared.configuration, prepared.wiring)["axis"][:, index]
        columns = np.column_stack([np.asarray(moved[name], dtype=float) for name in COLUMNS[loop]])
        try:
            U, Y = wave.spectra(rows["cycle"] - rows["cycle"][0], columns)
        except ValueError as problem:
            raise CheckFailed(f"the measurement can't be used: {problem}") from None
        return Response(
            number=self._number,
            done=True,
            progress=1.0,
            frequency_Hz=wave.frequency_Hz.tolist(),
            input=np.stack([U.real, U.imag], axis=-1).tolist(),
            output=np.stack([Y.real, Y.imag], axis=-1).tolist(),
        )
