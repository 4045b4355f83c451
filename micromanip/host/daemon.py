"""The host process of ``micromanip run``: heartbeat, control socket, live line, recorder, orderly end."""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from micromanip.bus.device_lock import DeviceLocks
from micromanip.bus.rights import go_before_ordinary_work, leave_cpu, lock_memory, precedence_restored
from micromanip.errors import CheckFailed, MicromanipError
from micromanip.faults import LOOP_DIED, LOOP_STUCK, FaultReport
from micromanip.host.recording.recordings import Recordings
from micromanip.host.safe.snapshot import SnapshotService
from micromanip.host.trips.store import KEPT, default_folder
from micromanip.host.trips.supervisor import BlackBox
from micromanip.rt import mailbox as w
from micromanip.rt import states
from micromanip.settings.check import Prepared, refuse_real
from micromanip.settings.schema.faults import LOOP_STUCK_S
from micromanip.settings.text.source import Source
from micromanip.status_reply import Status

from . import journal
from .arming import HostArming
from .child import Child
from .control.audit import AuditTrail
from .control.authority import Peer
from .control.server import ControlSocket
from .control.socket_file import Access
from .control.verbs import Verbs
from .controller import Controller
from .failures import Failures
from .learning.service import LearningService
from .notify import ServiceManager
from .realtime import NO_NICE, missing_rights
from .state_directory import state_directory
from .statistics import Gathered, report
from .workers import Workers

_HEARTBEAT_S = 0.02
"""The loop ends when it has no sign of life of this process for a second."""
_NICE = -10
_WORKERS, _SWITCH_S = 2, 0.001
"""Threads that check values and write files, and how soon they let the heartbeat have its turn."""
_LOOK_S = 0.2
_STOP_S = 30.0
_DISOBEYED = f"the loop process did not end within {_STOP_S:g} s of the stop command, and was killed by the host"

Say = Callable[[str | FaultReport], None]
Report = Status


@dataclass(frozen=True)
class Options:
    """What the command line says about one run."""

    socket: Path
    duration_s: float | None = None
    """How long it is at work: from READY, or from being armed by `arm_on_start`; reaching devices does not count."""
    record: Path | None = None
    recordings: Path | None = None
    trips: Path | None = None
    kept_trips: int = KEPT
    work: Callable[[Controller, Recordings, HostArming, Callable[[], bool]], Awaitable[None]] | None = None
    """What it does from READY on, before that duration begins."""


class Daemon:
    """Runs one configuration until its duration is over, a signal stops it, or the loop ends."""

    def __init__(
        self,
        prepared: Prepared,
        options: Options,
        say: Say,
        show: Callable[[Report], None],
        locks: tuple[int, ...] = (),
        process: Child | None = None,
    ) -> None:
        """`say` gets messages and faults for people, `show` the report five times a second; `locks` are devices'.

        `process` is a loop process that was begun already.
        """
        self._prepared, self._options = prepared, options
        self._stop = asyncio.Event()
        self._say, self._show = say, show
        self._failures = Failures(self._stop.set)
        self._controller = Controller(prepared, options.socket, locks, process)
        self._workers = Workers(
            prepared, self._controller.segments, self._controller.offsets, locks, say, self._stop.is_set
        )
        self._controller.adopted = self._workers.adopt
        self._gathered = Gathered(self._controller)
        self._boxes = BlackBox(self._controller, options.trips or default_folder(), options.kept_trips, say)
        self._trail = AuditTrail(state_directory(), say)
        self._snapshot = SnapshotService(prepared, state_directory(), say)
        self._recordings = Recordings(self._controller, options.recordings, say)
        note = partial(self._trail.note, Peer("configuration"), "arm")
        self._arming = HostArming(self._controller, note, say, experiments=options.work is not None)
        self._verbs = Verbs(
            self._controller,
            self._trail,
            self._report,
            self._boxes.settle,
            self._in_force,
            say,
            self._recordings,
            self._arming.leave_to,
        )
        self._learning = self._learner()
        self._reloading: asyncio.Task[None] | None = None
        self._service = ServiceManager()
        self._beats = self._looks = 0
        self._mute = False

    async def run(self) -> Report:
        """The whole life of the controller; returns its final report, raises CheckFailed where the loop died."""
        loop = asyncio.get_running_loop()
        loop.set_default_executor(ThreadPoolExecutor(_WORKERS, "verbs"))
        loop.set_exception_handler(self._failures.unhandled)
        sys.setswitchinterval(_SWITCH_S)
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._stop.set)
        loop.add_signal_handler(signal.SIGHUP, self._hang_up)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGHUP])  # who began this process may have blocked it
        await asyncio.sleep(0)  # a Ctrl-C that came before takes effect here, where nothing is begun yet
        control = self._prepared.configuration.control
        access = Access(operate_group=control.operate_group, observe_group=control.observe_group)
        control_socket = ControlSocket(
            self._options.socket, self._verbs.table(), access, refused=self._trail.refused, failed=self._failures.hear
        )
        await control_socket.open()
        try:
            leave_cpu(self._prepared.configuration.loop.cpu)
            report(self._controller, self._gathered)  # what it compiles would later hold up the sign of life
            self._service.status("STARTING: compiling, opening the drivers, warming up")
            gc.collect()
            gc.freeze()  # nor must a walk through all that was imported
            lock_memory(once_touched=True)  # nor code that has to be read from the disk again
            if not go_before_ordinary_work(_NICE):
                self._say(f"WARNING: {NO_NICE}")
            async with self._workers:
                refuse_real(self._prepared)
                # while the loop process imports, and before it looks for signs of life
                warnings = await asyncio.to_thread(lambda: self._prepared.warnings)
                await self._snapshot.keep(self._prepared.source)
                await self._controller.start(ready=False, say=self._say)
                return await self._supervise(warnings)
        finally:
            control_socket.close()
            await self._snapshot.settle()
            await self._trail.close()

    async def _supervise(self, warnings: list[str]) -> Report:
        rights = missing_rights(int(self._controller.words[w.RIGHTS]))
        for warning in (*rights, *warnings):
            self._say(f"WARNING: {warning}")
        ended = asyncio.create_task(self._controller.wait())
        helpers = [asyncio.create_task(task) for task in (self._beat(), self._look(), self._feed())]
        helpers += map(asyncio.create_task, (self._verbs.follow_trials(), self._trail.follow_repeats()))
        for helper in helpers:
            self._failures.watch(helper)
        stopped = asyncio.create_task(self._stop.wait())
        try:
            self._boxes.start()
            if self._learning is not None:
                self._learning.start()
            if self._options.record is not None:
                await self._recordings.begin(self._options.record)
            over = lambda: ended.done() or stopped.done()  # noqa: E731
            if await self._workers.in_hand(over) and await self._controller.loop_links_follow(over):
                self._notify_ready()
                if self._prepared.configuration.arm_on_start:
                    await self._arming.arm(over)
                if self._options.work is not None:
                    await self._options.work(self._controller, self._recordings, self._arming, over)
            await asyncio.wait({ended, stopped}, timeout=self._options.duration_s, return_when=asyncio.FIRST_COMPLETED)
            if not ended.done():
                await self._end(ended)
            await self._judge()
            await self._boxes.stop()
            self._boxes.announce(last=True)
            await self._end_recording()
            self._failures.judge()
            return self._report()
        finally:
            if not ended.done():  # an error: nobody leaves while the loop still drives the outputs
                await self._end(ended)
            await self._boxes.stop()
            for task in (*helpers, stopped):
                task.cancel()
            await self._end_recording()
            if self._learning is not None:
                await self._learning.end()

    def _in_force(self, source: Source) -> None:
        """Another configuration has come into force: who keeps what runs follows."""
        self._boxes.configured(source)
        self._snapshot.follow(source)

    def _notify_ready(self) -> None:
        """The one place where starting is over: for `status`, for `arm`, for people and for the service manager."""
        self._controller.declare_ready()
        self._say("READY")
        self._service.ready()

    async def _end_recording(self) -> None:
        """After the last cycle; the control does not end for it."""
        if (outcome := await self._recordings.end()) is not None:
            self._say(outcome)

    async def _end(self, ended: asyncio.Task[None]) -> None:
        """Ramp down and let the loop end."""
        self._service.stopping()
        try:
            await self._controller.command(states.STOP)
        except CheckFailed:
            pass
        except Exception as problem:  # whatever it is, the loop is not left to itself: without its sign of life it ends
            self._failures.hear(problem)
            self._mute = True
        done, _ = await asyncio.wait({ended}, timeout=_STOP_S)
        if not done:
            self._controller.kill(FaultReport(LOOP_DIED, what=_DISOBEYED))
            await ended

    async def _judge(self) -> None:
        """Raise where the loop process did not end by itself, its outputs brought to the safe value."""
        died = self._controller.death
        if died is None:
            return
        await self._make_safe()
        report = await self._boxes.loop_died(died)
        self._boxes.announce(last=True)
        if journal.is_connected():
            journal.send(journal.fields(report))
        raise CheckFailed(str(report))

    async def _make_safe(self) -> None:
        """Bring the outputs to their safe value, and say of each driver what is known of them."""
        codes = await asyncio.to_thread(self._controller.make_safe)  # the workers are looked after meanwhile
        told = self._workers.outputs_text()
        for name, code in codes.items():
            done = "outputs at their safe value" if code == 0 else f"safe failed, code {code}"
            self._say(f"driver {name}: {told.get(name, done)}")

    async def _beat(self) -> None:
        while True:
            if not self._mute:
                self._controller.beat()
            self._beats += 1
            await asyncio.sleep(_HEARTBEAT_S)

    async def _feed(self) -> None:
        """Tell the service manager that all is alive: the loop turns, its sign of life is given, it is looked after."""
        words = self._controller.words
        await self._service.feed_while(lambda: (int(words[w.CYCLES_RUN]), self._beats, self._looks))

    async def _look(self) -> None:
        """Feed the live line; tell a fault once; end a loop process that lives but does not turn any more."""
        cycles, turned = -1, time.monotonic()
        stuck_s = LOOP_STUCK_S[self._prepared.configuration.loop.limits]
        while True:
            if self._controller.words[w.CYCLES_RUN] != cycles:
                cycles, turned = int(self._controller.words[w.CYCLES_RUN]), time.monotonic()
            elif time.monotonic() - turned > stuck_s:
                self._controller.kill(FaultReport(LOOP_STUCK, value=time.monotonic() - turned, limit=stuck_s))
                return
            self._show(self._report())
            for slow in self._gathered.signals.news():
                self._say(f"WARNING: {slow}")
            self._boxes.announce()
            latched = "".join(f": {fault}" for fault in self._controller.faults()[-1:])
            self._service.status(self._controller.state + latched + self._unrecorded())
            self._looks += 1
            await asyncio.sleep(_LOOK_S)

    def _report(self) -> Report:
        links = {**self._workers.report(), **self._controller.loop_links()}
        learning = None if self._learning is None else self._learning.status()
        recording = self._recordings.report()
        return report(self._controller, self._gathered, self._boxes.report(), links, recording, learning)

    def _learner(self) -> LearningService | None:
        """Who learns from part to part, where the configuration says so."""
        wanted = self._prepared.configuration.learning
        if wanted is None:
            return None
        note = partial(self._trail.note, Peer("learning"), "learn")
        service = LearningService(self._controller, wanted, self._verbs.put_again, note, self._say)
        self._verbs.learning = service
        return service

    def _unrecorded(self) -> str:
        recording = self._recordings.report()
        return "; nothing is recorded any more" if recording is not None and recording["state"] == "failed" else ""

    def _hang_up(self) -> None:
        """SIGHUP: of a service it means reload; of a terminal that was closed it means the end."""
        if sys.stdin is not None and sys.stdin.isatty():
            self._stop.set()
        else:
            self._reloading = asyncio.create_task(self._reload())

    async def _reload(self) -> None:
        try:
            with self._service.reload():
                swap = await self._verbs.ask("reload", Peer("SIGHUP"))
        except MicromanipError as refusal:
            self._say(f"WARNING: reload refused: {refusal}")
            return
        keys = ", ".join(change["key"] for change in swap["changed"]) or "nothing"
        for warning in (f"reloaded, changed: {keys}", *(f"WARNING: {text}" for text in swap["warnings"])):
            self._say(warning)


async def served(
    prepared: Prepared,
    options: Options,
    say: Say,
    show: Callable[[Report], None],
    process: Child | None = None,
) -> Report:
    """Run the daemon to its end, on a loop `process` that was begun already, if there is one; the final report.

    What this process asked of the kernel for that is given back: what it does afterwards is in no hurry.
    """
    with precedence_restored(), DeviceLocks(prepared.wiring.devices) as locks:
        return await Daemon(prepared, options, say, show, locks.descriptors, process).run()


def serve(prepared: Prepared, options: Options, say: Say, show: Callable[[Report], None]) -> Report:
    """The same for who has no event loop."""
    return asyncio.run(served(prepared, options, say, show))
