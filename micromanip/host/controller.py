"""One loop process and its shared memory, seen from the host: start it, command it, look at it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError, PermissionDenied
from micromanip.rt import words as w
from micromanip.rt.intrinsics import call_context
from micromanip.rt.states import ARM, COMMAND_NAMES, NO_FAULT, STARTING, STATE_NAMES
from micromanip.settings.check import Prepared

from .messages import fault_message
from .refusals import axis_refusals, refusals
from .segments import CONTROL, RING, SLOTS, STATUS, Segments, context_layout

_ANSWER_S = 1.0
_SENSORS_S = 0.05
"""Time for a first sample of every sensor, the slowest included, before the controller is READY."""


class Controller:
    """Owns the segments and the loop process of one configuration."""

    def __init__(self, prepared: Prepared, socket_path: Path, locks: tuple[int, ...] = ()) -> None:
        """`locks` are descriptors that the loop process holds too, as long as it lives."""
        self.prepared = prepared
        self._socket_path, self._locks = socket_path, locks
        contexts = [driver.context() for driver in prepared.wiring.drivers.values()]
        self._drivers = dict(prepared.wiring.drivers)
        # loaded now: it must neither take time nor fail once the loop has died
        self._safe = {name: driver.functions().safe for name, driver in self._drivers.items()}
        self._offsets, size = context_layout([len(context) for context in contexts])
        self.segments = Segments.create(size, prepared.samples)
        shared = self.segments.contexts.bytes()
        for offset, context in zip(self._offsets, contexts, strict=True):
            shared[offset : offset + len(context)] = context
        self.control = self.segments.control.record(CONTROL)
        self.status = self.segments.status.record(STATUS)
        self.ring = self.segments.ring.record(RING)
        self.control["parameters"][0] = prepared.parameters[0]
        self.control["words"][w.VERSION] = prepared.parameters[0]["version"]
        self.process: asyncio.subprocess.Process | None = None
        self._commands = asyncio.Lock()

    async def start(self) -> None:
        """Start the loop process; returns when it has run for so long that every sensor has said something.

        Raises what the loop process reports: DeviceUnavailable, PermissionDenied, or CheckFailed.
        """
        self.beat()
        self.process = await asyncio.create_subprocess_exec(
            sys.executable,
            *("-m", "micromanip.host.loop_process"),
            stdin=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            pass_fds=(*self.segments.descriptors, *self._locks),
            start_new_session=True,
        )
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(self._orders()).encode())
        self.process.stdin.close()
        heard = max(1, round(_SENSORS_S * 1e9 / self.prepared.configuration.loop.period_ns))
        while self.words[w.CYCLES_RUN] < heard:
            if self.process.returncode is not None:
                raise await self._start_failure(self.process)
            self.beat()
            await asyncio.sleep(0.005)

    def _orders(self) -> dict[str, Any]:
        configuration, wiring = self.prepared.configuration, self.prepared.wiring
        loop = configuration.loop
        drivers = [
            {
                "name": name,
                "driver": configuration.drivers[name].driver,
                "options": wiring.options[name].model_dump_json(),
                "context": offset,
                "first_input": wiring.first_input[name],
                "first_output": wiring.first_output[name],
            }
            for name, offset in zip(wiring.drivers, self._offsets, strict=True)
        ]
        return {
            "descriptors": self.segments.descriptors,
            "drivers": drivers,
            "period_ns": loop.period_ns,
            "cpu": loop.cpu,
            "priority": loop.priority,
            "spin_ns": round(loop.spin_us * 1e3),
            "refuse_without_rights": loop.limits == "hardware",
            "host": os.getpid(),
            "socket": str(self._socket_path),
        }

    async def _start_failure(self, process: asyncio.subprocess.Process) -> MicromanipError:
        assert process.stderr is not None
        said = (await process.stderr.read()).decode(errors="replace").strip()
        for kind in (DeviceUnavailable, PermissionDenied):
            if process.returncode == kind.exit_code:
                return kind(said)
        return CheckFailed(f"the loop process ended with {process.returncode} before its first cycle: {said}")

    @property
    def words(self) -> Any:
        """The loop's shared words."""
        return self.status["words"]

    @property
    def state(self) -> str:
        """Name of the cell's state."""
        if self.words[w.CYCLES_RUN] == 0:
            return STATE_NAMES[STARTING]
        return STATE_NAMES[int(self.words[w.STATE])]

    def beat(self) -> None:
        """Sign of life to the loop."""
        self.control["words"][w.HEARTBEAT_NS] = time.monotonic_ns()

    async def command(self, command: int) -> None:
        """Give a command (`states.ARM` ...) and wait for its outcome; CheckFailed where it was refused."""
        async with self._commands:
            words = self.control["words"]
            before = self.state
            if before == STATE_NAMES[STARTING]:
                raise CheckFailed(f"{COMMAND_NAMES[command]} refused: the controller is still starting")
            number = int(words[w.COMMAND_NUMBER]) + 1
            words[w.COMMAND] = command
            words[w.COMMAND_NUMBER] = number
            if not await self._reached(w.COMMAND_DONE, number):
                raise CheckFailed(f"{COMMAND_NAMES[command]}: the loop did not answer within {_ANSWER_S:g} s")
            if not self.words[w.COMMAND_ACCEPTED]:
                raise CheckFailed(f"{COMMAND_NAMES[command]} refused: {'; '.join(self._reasons(command, before))}")

    def _reasons(self, command: int, state: str) -> list[str]:
        """Why `command` was refused in `state`."""
        if command != ARM:
            return [f"the state is {state}", *self._latched()]
        cell = self.status["state"][0]
        axes = self.prepared.configuration.axes
        reasons = refusals(int(cell["refused"]), state)
        for i, name in enumerate(axes):
            reasons += axis_refusals(int(cell["axis"][i]["refused"]), name)
        return reasons + self._latched()

    def _latched(self) -> list[str]:
        fault = self.fault()
        return [fault] if fault else []

    async def adopt(self, prepared: Prepared, permit: Callable[[], None]) -> int:
        """Run `prepared` from the next cycle boundary on; the parameter version then in force.

        `permit` may raise; no command comes between it and the swap. Raises CheckFailed while the loop is starting.
        """

        def decide() -> None:
            if self.state == STATE_NAMES[STARTING]:
                raise CheckFailed("nothing was changed: the controller is still starting")
            permit()
            self.prepared = prepared

        await self.apply(prepared.parameters, decide)
        return int(self.control["words"][w.VERSION])

    async def apply(self, parameters: Any, permit: Callable[[], None] = lambda: None) -> None:
        """Swap to the parameters (1,) at a cycle boundary; CheckFailed where the loop does not take them."""
        async with self._commands:
            permit()
            words = self.control["words"]
            slot, version = (int(words[w.SLOT]) + 1) % SLOTS, int(words[w.VERSION]) + 1
            self.control["parameters"][slot] = parameters[0]
            self.control["parameters"][slot]["version"] = version
            words[w.SLOT] = slot
            words[w.VERSION] = version
            if not await self._reached(w.VERSION_ACTIVE, version):
                raise CheckFailed(
                    f"the loop did not take the new parameters within {_ANSWER_S:g} s, but it will when it turns again"
                )

    async def snapshot(self) -> int:
        """Let the loop copy its whole state at a cycle boundary; returns that cycle."""
        number = int(self.control["words"][w.SNAPSHOT_NUMBER]) + 1
        self.control["words"][w.SNAPSHOT_NUMBER] = number
        if not await self._reached(w.SNAPSHOT_DONE, number):
            raise CheckFailed(f"the loop made no snapshot within {_ANSWER_S:g} s")
        return int(self.status["snapshot"][0]["cycle"])

    async def _reached(self, word: int, value: int) -> bool:
        end = time.monotonic() + _ANSWER_S
        while self.words[word] != value:
            if time.monotonic() > end:
                return False
            await asyncio.sleep(0.001)
        return True

    def fault(self) -> str | None:
        """The latched fault in plain words."""
        state = self.status["state"][0]
        if state["fault"] == NO_FAULT:
            return None
        names = list(self.prepared.configuration.axes)
        axis = names[state["fault_axis"]] if state["fault_axis"] >= 0 else None
        return fault_message(int(state["fault"]), axis, float(state["fault_value"]), float(state["fault_limit"]))

    def make_safe(self) -> list[str]:
        """Bring the outputs to their safe value with the loop dead; one line a driver."""
        done = []
        base = self.segments.contexts.bytes().ctypes.data
        for (name, safe), offset in zip(self._safe.items(), self._offsets, strict=True):
            code = call_context(safe, base + offset)
            done.append(
                f"driver {name}: " + ("outputs at their safe value" if code == 0 else f"safe failed, code {code}")
            )
        return done

    def kill(self) -> None:
        """End the loop process at once; `make_safe` is then the host's to call."""
        if self.process is not None and self.process.returncode is None:
            self.process.kill()

    async def wait(self) -> int:
        """Wait for the loop process to end; its exit code (negative: the signal that killed it)."""
        assert self.process is not None
        with contextlib.suppress(ValueError):
            assert self.process.stderr is not None
            sys.stderr.write((await self.process.stderr.read()).decode(errors="replace"))
        return await self.process.wait()
