"""One loop process and its shared memory, seen from the host: start it, command it, look at it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from micromanip.bus.rights import beginning_on_cpu
from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError, PermissionDenied
from micromanip.rt import mailbox as w
from micromanip.rt.intrinsics import call_context
from micromanip.rt.states import (
    ARM,
    COMMAND_NAMES,
    FAULT,
    NO_FAULT,
    PROMOTE,
    RESET,
    SHADOWING,
    STARTING,
    STATE_NAMES,
    STOP,
)
from micromanip.rt.tell import ask, tell
from micromanip.settings.check import Prepared

from .loop_orders import loop_orders
from .messages import fault_message
from .parameter_buffers import ParameterSlots
from .refusals import axis_refusals, output_refusals, refusals
from .shared_memory import CONTROL, RING, STATUS, Segments, context_layout

_ANSWER_S = 1.0
_READY_S = 8.0
"""A command that comes between the loop's first cycle and READY waits so long: a recorder may have to be started."""
_SENSORS_S = 0.05
"""Time for a first sample of every sensor, the slowest included, before the controller is READY."""


class Controller:
    """Owns the segments and the loop process of one configuration."""

    def __init__(self, prepared: Prepared, socket_path: Path, locks: tuple[int, ...] = ()) -> None:
        """`locks` are descriptors that the loop process holds too, as long as it lives."""
        self._prepared = prepared
        self.adopted: Callable[[Prepared], None] = lambda _: None
        """Hears of each configuration that comes into force."""
        self._socket_path, self._locks = socket_path, locks
        contexts = [driver.context() for driver in prepared.wiring.drivers.values()]
        self._drivers = dict(prepared.wiring.drivers)
        # loaded now: it must neither take time nor fail once the loop has died
        self._safe = {name: driver.functions().safe for name, driver in self._drivers.items()}
        self.offsets, size = context_layout([len(context) for context in contexts])
        self.segments = Segments.create(size, prepared.samples)
        shared = self.segments.contexts.bytes()
        for offset, context in zip(self.offsets, contexts, strict=True):
            shared[offset : offset + len(context)] = context
        self.control = self.segments.control.record(CONTROL)
        self.status = self.segments.status.record(STATUS)
        self.ring = self.segments.ring.record(RING)
        self.slots = ParameterSlots(self.control, self.words, prepared.parameters[0])
        self.process: asyncio.subprocess.Process | None = None
        self._commands = asyncio.Lock()
        self._ready = False

    @property
    def prepared(self) -> Prepared:
        """The configuration in force."""
        return self._prepared

    @prepared.setter
    def prepared(self, prepared: Prepared) -> None:
        self._prepared = prepared
        self.adopted(prepared)

    async def start(self, *, ready: bool = True) -> None:
        """Start the loop process; returns when it has run for so long that every sensor has said something.

        `ready` says that starting is over then; else `declare_ready` will.
        Raises what the loop process reports: DeviceUnavailable, PermissionDenied, or CheckFailed.
        """
        self.beat()
        orders = loop_orders(self.prepared, self.segments.descriptors, self.offsets, self._socket_path)
        with beginning_on_cpu(self.prepared.configuration.loop.cpu):
            self.process = await asyncio.create_subprocess_exec(
                sys.executable,
                *("-m", "micromanip.host.loop_process"),
                stdin=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.PIPE,
                pass_fds=(*self.segments.descriptors, *self._locks),
                start_new_session=True,
            )
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(orders).encode())
        self.process.stdin.close()
        heard = max(1, round(_SENSORS_S * 1e9 / self.prepared.configuration.loop.period_ns))
        while self.words[w.CYCLES_RUN] < heard:
            if self.process.returncode is not None:
                raise await self._start_failure(self.process)
            self.beat()
            await asyncio.sleep(0.005)
        self._ready = ready

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
        if not self._ready:
            return STATE_NAMES[STARTING]
        return STATE_NAMES[int(self.words[w.STATE])]

    def declare_ready(self) -> None:
        """Starting is over: from now on `state` is the cell's, and `arm` is given to the loop."""
        self._ready = True

    def beat(self) -> None:
        """Sign of life to the loop."""
        self.control["words"][w.HEARTBEAT_NS] = time.monotonic_ns()

    async def command(self, command: int) -> None:
        """Give a command (`states.ARM` ...) and wait for its outcome; CheckFailed where it was refused."""
        if not ((command == STOP and self._turns) or await self._is_ready()):
            raise CheckFailed(f"{COMMAND_NAMES[command]} refused: the controller is still starting")
        async with self._commands:
            words = self.control["words"]
            before = self.state
            number = int(words[w.COMMAND_NUMBER]) + 1
            if command == PROMOTE:
                self.slots.keep_for_trial()
            words[w.COMMAND] = command
            tell(words, w.COMMAND_NUMBER, number)
            if not await _comes_true(lambda: ask(self.words, w.COMMAND_DONE) == number):
                raise CheckFailed(f"{COMMAND_NAMES[command]}: the loop did not answer within {_ANSWER_S:g} s")
            if not self.words[w.COMMAND_ACCEPTED]:
                raise CheckFailed(f"{COMMAND_NAMES[command]} refused: {'; '.join(self._reasons(command, before))}")

    @property
    def _turns(self) -> bool:
        return bool(self.words[w.CYCLES_RUN] > 0)

    async def _is_ready(self) -> bool:
        """Whether starting is over; who comes after the loop's first cycle waits for it, and is not refused."""
        return self._ready or (self._turns and await _comes_true(lambda: self._ready, _READY_S))

    def _reasons(self, command: int, state: str) -> list[str]:
        """Why `command` was refused in `state`."""
        cell = self.status["state"][0]
        if command == RESET and state == STATE_NAMES[FAULT] and (elsewhere := output_refusals(cell, state)):
            return elsewhere
        if command != ARM:
            return [f"the state is {state}", *self._latched()]
        axes = self.prepared.configuration.axes
        reasons = refusals(int(cell["refused"]), state)
        for i, name in enumerate(axes):
            reasons += axis_refusals(int(cell["axis"][i]["refused"]), name)
        return reasons + self._latched()

    def _latched(self) -> list[str]:
        fault = self.fault()
        return [fault] if fault else []

    @contextlib.asynccontextmanager
    async def commanding(self) -> AsyncIterator[None]:
        """Nobody else commands the loop meanwhile. Raises CheckFailed while the loop is starting."""
        if not await self._is_ready():
            raise CheckFailed("nothing was changed: the controller is still starting")
        async with self._commands:
            yield

    async def apply(self, prepared: Prepared) -> int:
        """Swap to `prepared` at a cycle boundary; its version. CheckFailed where the loop takes none."""
        version = self.slots.put_in_force(prepared.parameters)
        self.prepared = prepared
        await self._take("new parameters", lambda: ask(self.words, w.VERSION_ACTIVE) == version)
        self.slots.taken()
        return version

    async def offer(self, prepared: Prepared) -> int:
        """Let a candidate compute beside what is in force; its version. CheckFailed where the loop takes none."""
        version = self.slots.offer(prepared.parameters)
        shadow = self.status["shadow"][0]
        await self._take("candidate", lambda: self.words[w.SHADOW] == SHADOWING and shadow["version"] == version)
        return version

    async def _take(self, what: str, taken: Callable[[], bool]) -> None:
        if not await _comes_true(taken):
            raise CheckFailed(
                f"the loop did not take the {what} within {_ANSWER_S:g} s, but it will when it turns again"
            )

    async def snapshot(self) -> int:
        """Let the loop copy its whole state at a cycle boundary; returns that cycle."""
        number = int(self.control["words"][w.SNAPSHOT_NUMBER]) + 1
        tell(self.control["words"], w.SNAPSHOT_NUMBER, number)
        if not await _comes_true(lambda: ask(self.words, w.SNAPSHOT_DONE) == number):
            raise CheckFailed(f"the loop made no snapshot within {_ANSWER_S:g} s")
        return int(self.status["snapshot"][0]["cycle"])

    def fault(self) -> str | None:
        """The latched fault in plain words; where there are two, the one that ends the run."""
        return self._fault_message("fault")

    def faults(self) -> list[str]:
        """Every latched fault, the one that ends the run last."""
        return [message for name in ("former", "fault") if (message := self._fault_message(name)) is not None]

    def _fault_message(self, name: str) -> str | None:
        state = self.status["state"][0]
        if state[name] == NO_FAULT:
            return None
        configuration = self.prepared.configuration
        names = list(configuration.axes)
        axis = names[state[f"{name}_axis"]] if state[f"{name}_axis"] >= 0 else None
        value, limit = float(state[f"{name}_value"]), float(state[f"{name}_limit"])
        return fault_message(int(state[name]), axis, value, limit, list(configuration.drivers))

    def make_safe(self) -> dict[str, int]:
        """Bring the outputs to their safe value with the loop dead; by driver 0, or a code where that failed."""
        base = self.segments.contexts.bytes().ctypes.data
        pairs = zip(self._safe.items(), self.offsets, strict=True)
        return {name: call_context(safe, base + offset) for (name, safe), offset in pairs}

    def kill(self) -> None:
        """End the loop process at once; `make_safe` is then the host's to call."""
        if self.process is not None and self.process.returncode is None:
            self.process.kill()

    async def wait(self) -> int:
        """Wait for the loop process to end; its exit code (negative: the signal that killed it)."""
        assert self.process is not None
        with contextlib.suppress(ValueError, OSError):
            assert self.process.stderr is not None
            sys.stderr.write((await self.process.stderr.read()).decode(errors="replace"))
        return await self.process.wait()


async def _comes_true(condition: Callable[[], bool], patience_s: float = _ANSWER_S) -> bool:
    """Wait for the loop's answer, or something else; False where it does not come."""
    end = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > end:
            return False
        await asyncio.sleep(0.001)
    return True
