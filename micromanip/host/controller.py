"""One loop process and its shared memory, seen from the host: start it, command it, look at it."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any

from micromanip.bus.rights import put_on_cpu
from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError, PermissionDenied
from micromanip.faults import LOOP_DIED, FaultReport, latched
from micromanip.rt import mailbox as w
from micromanip.rt.mailbox import ask, tell
from micromanip.rt.states import (
    ARM,
    COMMAND_NAMES,
    FAULT,
    PROMOTE,
    SHADOWING,
    STARTING,
    STATE_NAMES,
    STOP,
)
from micromanip.settings.check import Prepared
from micromanip.status_reply import Link

from .child import Child, loop_process
from .parameter_buffers import ParameterBuffers
from .realtime import cpu_conflicts
from .refusals import Refused, awaited, refusals
from .shared_memory import CONTROL, RING, STATUS, Segments, context_layout
from .workers import follow, loop_link

_ANSWER_S = 1.0
_READY_S = 8.0
"""A command that comes between the loop's first cycle and READY waits so long: a recorder may have to be started."""
_SENSORS_S = 0.05
"""Time for a first sample of every sensor, the slowest included, before the controller is READY."""


def _to_stderr(text: str) -> None:
    sys.stderr.write(f"{text}\n")


class Controller:
    """Owns the segments and the loop process of one configuration."""

    def __init__(
        self, prepared: Prepared, socket_path: Path, locks: tuple[int, ...] = (), process: Child | None = None
    ) -> None:
        """`locks` are descriptors that the loop process holds too, as long as it lives; `process` has begun."""
        self._prepared = prepared
        self.adopted: Callable[[Prepared], None] = lambda _: None
        """Hears of each configuration that comes into force."""
        self.added: Callable[..., Any] = lambda _, parameters, **__: parameters
        """What else is in each set of parameters of a configuration that is handed over: a learned correction."""
        self._socket_path = socket_path
        self._say: Callable[[str], None] = lambda _: None
        contexts = [driver.context() for driver in prepared.wiring.drivers.values()]
        self._drivers = dict(prepared.wiring.drivers)
        # loaded now: it must neither take time nor fail once the loop has died
        self._safe = {name: driver.safe_in_host() for name, driver in self._drivers.items()}
        self.offsets, size = context_layout([len(context) for context in contexts])
        self.segments = Segments.create(size, prepared.samples)
        shared = self.segments.contexts.bytes()
        self._contexts = [shared[at : at + len(each)] for at, each in zip(self.offsets, contexts, strict=True)]
        for place, context in zip(self._contexts, contexts, strict=True):
            place[:] = context
        self._publish_limits(prepared)
        self.control = self.segments.control.record(CONTROL)
        self.status = self.segments.status.record(STATUS)
        self.ring = self.segments.ring.record(RING)
        self.buffers = ParameterBuffers(self.control, self.words, prepared.parameters[0])
        self._handed_on = (*self.segments.descriptors, *locks)
        self.process = process or loop_process()
        """Once it has ended before its time, `make_safe` is the host's to call."""
        self._relaying: asyncio.Task[None] | None = None
        self._commands = asyncio.Lock()
        self._ready = False
        self._killed: FaultReport | None = None
        """Why this process has killed the loop process, where it has."""

    @property
    def prepared(self) -> Prepared:
        """The configuration in force."""
        return self._prepared

    @prepared.setter
    def prepared(self, prepared: Prepared) -> None:
        self._prepared = prepared
        self._publish_limits(prepared)
        self.adopted(prepared)

    def _publish_limits(self, prepared: Prepared) -> None:
        for (name, driver), context in zip(self._drivers.items(), self._contexts, strict=True):
            driver.adopt(context, prepared.wiring.safe_outputs(name, prepared.configuration))

    async def start(self, *, ready: bool = True, say: Callable[[str], None] = _to_stderr) -> None:
        """Start the loop process; returns when it has run for so long that every sensor has said something.

        `ready` says that starting is over then; else `declare_ready` will. `say` gets what takes long meanwhile, and
        line by line what the loop process complains of, as long as it runs.
        Raises what the loop process reports: DeviceUnavailable, PermissionDenied, or CheckFailed.
        """
        self.beat()
        self._say = say
        places = [(at, len(context)) for at, context in zip(self.offsets, self._contexts, strict=True)]
        if self.process.starts == 0:
            await self.process.begin()
        if self.process.runs:
            cpu = self.prepared.configuration.loop.cpu
            put_on_cpu(self.process.pid, cpu)
            for conflict in cpu_conflicts(cpu, self.process.pid):
                say(
                    f"WARNING: CPU {cpu} is this loop's (loop.cpu), and {conflict}: both miss their deadlines, and "
                    "this one may stay STARTING; give one of them another CPU"
                )
        self.process.send_orders(_loop_orders(self.prepared, places, self._socket_path), self._handed_on)
        self._relaying = asyncio.create_task(self._relay())
        heard = max(1, round(_SENSORS_S * 1e9 / self.prepared.configuration.loop.period_ns))
        while self.words[w.CYCLES_RUN] < heard:
            if not self.process.runs:
                raise await self._start_failure()
            self.beat()
            await asyncio.sleep(0.005)
        self._ready = ready

    async def _start_failure(self) -> MicromanipError:
        said = (await self.process.complaint()).strip()
        for kind in (DeviceUnavailable, PermissionDenied):
            if self.process.code == kind.exit_code:
                return kind(said)
        return CheckFailed(f"the loop process ended with {self.process.code} before its first cycle: {said}")

    @property
    def words(self) -> Any:
        """The loop's shared words."""
        return self.status["words"]

    @property
    def state(self) -> str:
        """Name of the cell's state; FAULT once the loop process has died, whatever it said last."""
        if self.death is not None:
            return STATE_NAMES[FAULT]
        if not self._ready:
            return STATE_NAMES[STARTING]
        return STATE_NAMES[int(self.words[w.STATE])]

    @property
    def death(self) -> FaultReport | None:
        """How the loop process has ended without bringing its outputs to rest; None where it has not."""
        if self.process.code is None or self.words[w.FINISHED]:
            return None
        return self._killed or FaultReport(LOOP_DIED, what=f"the loop process {self.process.end}")

    def loop_links(self) -> dict[str, Link]:
        """Where the wires stand that the loop itself serves, by the driver's name."""
        found = {}
        for (name, driver), context in zip(self._drivers.items(), self._contexts, strict=True):
            if (wire := driver.wire(context)) is not None:
                places = self.prepared.wiring.places(name)
                found[name] = loop_link(driver, wire, driver.statistics(context), places)
        return found

    def missing(self) -> dict[int, int]:
        """Samples known never to have come, by the input's index; without those of drivers that can't tell."""
        found: dict[int, int] = {}
        for (name, driver), context in zip(self._drivers.items(), self._contexts, strict=True):
            if (counts := driver.missing(context)) is not None:
                found |= dict(enumerate(counts.tolist(), self.prepared.wiring.first_input[name]))
        return found

    async def loop_links_follow(self, ends: Callable[[], bool]) -> bool:
        """Wait until what is on the loop's own wires follows it, also by its clock; False where it `ends` before."""
        steering = next((name for name, driver in self._drivers.items() if driver.steers), None)
        return await follow(self.loop_links, steering, ends)

    def declare_ready(self) -> None:
        """Starting is over: from now on `state` is the cell's, and `arm` is given to the loop."""
        self._ready = True

    def beat(self) -> None:
        """Sign of life to the loop."""
        self.control["words"][w.HEARTBEAT_NS] = time.monotonic_ns()

    async def command(self, command: int) -> None:
        """Give a command (`states.ARM` ...) and wait for its outcome; Refused where the loop does not obey."""
        if not ((command == STOP and self._turns) or await self._is_ready()):
            raise CheckFailed(f"{COMMAND_NAMES[command]} refused: the controller is still starting")
        async with self._commands:
            self._refuse_dead(f"{COMMAND_NAMES[command]} refused")
            words = self.control["words"]
            before = self.state
            number = int(words[w.COMMAND_NUMBER]) + 1
            if command == PROMOTE:
                self.buffers.keep_for_trial()
            words[w.COMMAND] = command
            tell(words, w.COMMAND_NUMBER, number)
            if not await _comes_true(lambda: ask(self.words, w.COMMAND_DONE) == number):
                raise CheckFailed(f"{COMMAND_NAMES[command]}: the loop did not answer within {_ANSWER_S:g} s")
            if not self.words[w.COMMAND_ACCEPTED]:
                cell, configuration = self.status["state"][0], self.prepared.configuration
                why = refusals(command, cell, before, configuration, self.faults())
                yet = awaited(cell, configuration) if command == ARM else None
                raise Refused(f"{COMMAND_NAMES[command]} refused: {'; '.join(why)}", yet)

    def _refuse_dead(self, what: str) -> None:
        if (death := self.death) is not None:
            raise CheckFailed(f"{what}: {death}")

    @property
    def _turns(self) -> bool:
        return bool(self.words[w.CYCLES_RUN] > 0)

    async def _is_ready(self) -> bool:
        """Whether starting is over; who comes after the loop's first cycle waits for it, and is not refused."""
        return self._ready or (self._turns and await _comes_true(lambda: self._ready, _READY_S))

    @contextlib.asynccontextmanager
    async def commanding(self) -> AsyncIterator[None]:
        """Nobody else commands the loop meanwhile. Raises CheckFailed while the loop is starting."""
        if not await self._is_ready():
            raise CheckFailed("nothing was changed: the controller is still starting")
        async with self._commands:
            self._refuse_dead("nothing was changed")
            yield

    async def apply(self, prepared: Prepared) -> int:
        """Swap to `prepared` at a cycle boundary; its version. CheckFailed where the loop takes none."""
        version = self.buffers.put_in_force(self.added(prepared, prepared.parameters))
        self.prepared = prepared
        await self._taken(version)
        return version

    async def inject(self, parameters: Any) -> None:
        """Swap to the `parameters` of the configuration in force but for an injection; errors as `apply`."""
        await self._taken(self.buffers.put_in_force(self.added(self.prepared, parameters)))

    async def _taken(self, version: int) -> None:
        await self._take("new parameters", lambda: ask(self.words, w.VERSION_ACTIVE) == version)
        self.buffers.taken()

    async def offer(self, prepared: Prepared) -> int:
        """Let a candidate compute beside what is in force; its version. CheckFailed where the loop takes none."""
        version = self.buffers.offer(self.added(prepared, prepared.parameters, candidate=True))
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

    def latched(self) -> list[FaultReport]:
        """Every fault that is latched in the loop's state, the one that ends the run last."""
        configuration = self.prepared.configuration
        return latched(self.status["state"][0], list(configuration.axes), list(configuration.drivers))

    def faults(self) -> list[FaultReport]:
        """The same, and how the loop died, where it did: that is last."""
        return self.latched() if (death := self.death) is None else [*self.latched(), death]

    def make_safe(self) -> dict[str, int]:
        """Bring the outputs to their safe value with the loop dead; by driver 0, or a code where that failed."""
        return {name: safe(context) for (name, safe), context in zip(self._safe.items(), self._contexts, strict=True)}

    async def _relay(self) -> None:
        """Pass on what the loop process tells people while it starts."""
        async for answer in self.process.answers():
            self._say(str(answer["text"]))

    def kill(self, why: FaultReport) -> None:
        """End the loop process at once; `make_safe` is then the host's to call, and `why` what is said of it."""
        if self.process.runs:
            self._killed = why
            self.process.kill()

    async def wait(self) -> None:
        """Wait for the loop process to end, and pass on what it complains of; `process` knows how it ended."""
        async for line in self.process.complaints():
            with contextlib.suppress(ValueError, OSError):
                self._say(line)
        await self.process.wait()


def _loop_orders(prepared: Prepared, places: Sequence[tuple[int, int]], socket_path: Path) -> dict[str, Any]:
    """Orders for the loop of `prepared`; `places`: where in its segment each driver's context begins, and its size."""
    configuration, wiring = prepared.configuration, prepared.wiring
    loop = configuration.loop
    drivers = [
        {
            "name": name,
            "driver": configuration.drivers[name].driver,
            "bus": name in wiring.buses,
            "options": wiring.options[name].model_dump_json(),
            "context": at,
            "context_bytes": size,
            "first_input": wiring.first_input[name],
            "first_output": wiring.first_output[name],
        }
        for name, (at, size) in zip(wiring.drivers, places, strict=True)
    ]
    return {
        "drivers": drivers,
        "period_ns": loop.period_ns,
        "cpu": loop.cpu,
        "priority": loop.priority,
        "spin_ns": round(loop.spin_us * 1e3),
        "refuse_without_rights": loop.limits == "hardware",
        "host": os.getpid(),
        "socket": str(socket_path),
    }


async def _comes_true(condition: Callable[[], bool], patience_s: float = _ANSWER_S) -> bool:
    """Wait for the loop's answer, or something else; False where it does not come."""
    end = time.monotonic() + patience_s
    while not condition():
        if time.monotonic() > end:
            return False
        await asyncio.sleep(0.001)
    return True
