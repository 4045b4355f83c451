"""One driver worker, seen from the host: started, listened to, started again, ended."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from micromanip.bus import device_lock
from micromanip.bus.backoff import RestartLimit
from micromanip.bus.image import ProcessImage
from micromanip.errors import DeviceUnavailable
from micromanip.rt.bus_image import (
    ALIVE_NS,
    AT_REST,
    EPOCH,
    FOLLOWING,
    IMAGE,
    LINK,
    LINK_DOWN,
    LINK_LATCHED,
    LINK_UP,
    OUTPUT_NAMES,
    OUTPUT_STATE,
    RESTING,
    SENT_NS,
    UNKNOWN,
)
from micromanip.settings.check import Prepared
from micromanip.status_reply import Link

from .child import Child
from .shared_memory import Segments

_START_S = 120.0
"""Time for a process to begin: a small processor takes a minute to import what it needs."""
_FIRST_LINK_S, _TRIED_S = 10.0, 2.0
"""Time for the first link: for a process that has begun or says that it is opening, and after the first try failed."""
_WORDS_S = 1.0
"""The reason of a state is on its way for so long at most, where this process comes late to it."""
_STUCK_S, _AGAIN_S = 2.0, 1.0
_END_S = 5.0
"""A worker that is to end is waited for as long as its device takes values, and so much longer."""
_NEVER_UP_S = 0.5
"""The same for one that never had a link: its device was given nothing."""
_POLL_S = 0.02
_BELOW_LOOP = 10
"""Priority of a worker below that of the loop."""


class BusWorker:
    """One worker process and what it has said."""

    def __init__(self, prepared: Prepared, name: str, segments: Segments, offset: int, locks: tuple[int, ...]) -> None:
        """`offset` (bytes) tells where the bus' image is in the contexts' segment."""
        self.name = name
        self._source = prepared.source
        descriptors = (segments.contexts.descriptor, *locks)
        self._child = Child("micromanip.bus.worker_process", descriptors, complains=True)
        self._restarts = RestartLimit()
        self._orders = _orders(prepared, name, segments.contexts.descriptor, offset)
        self._places = prepared.wiring.places(name)
        self._voltages = [output for output in self._places if output in prepared.configuration.outputs]
        self.image = ProcessImage(segments.contexts.bytes()[offset : offset + IMAGE.itemsize].view(IMAGE))
        self._listening: asyncio.Task[None] | None = None
        self._ending = False
        self._started = 0.0
        self.said = ""
        self._is_slow = False
        """Whether people know that it takes its time to open."""
        self._opening = False
        """Whether it has said since it was looked for last that opening takes its time."""
        self.counts: dict[str, int] = {}
        self.cpu_s = 0.0

    async def start(self, say: Callable[[str], None]) -> None:
        """Start the process; what it says that people should know goes to `say`."""
        await self._child.start(self._orders)
        self._started = time.monotonic()
        self._listening = asyncio.create_task(self._listen(say))

    async def first_link(self, ends: Callable[[], bool]) -> None:
        """Wait until the link has come up; DeviceUnavailable with the reason where it does not.

        KeyboardInterrupt where it `ends` before that: nothing has been given to a device.
        """
        end = time.monotonic() + _START_S
        begun = tried = False
        while self.image.ask(LINK) != LINK_UP:
            if ends():
                raise KeyboardInterrupt
            if not begun and self._has_begun():
                begun, end = True, time.monotonic() + _FIRST_LINK_S
            if self._opening:
                self._opening, end = False, max(end, time.monotonic() + _FIRST_LINK_S)
            if self.said and not tried:
                tried, end = True, time.monotonic() + _TRIED_S
            if not self._child.runs or self.image.ask(LINK) == LINK_LATCHED or time.monotonic() > end:
                if not self._child.runs and self._listening is not None:
                    await self._listening
                words = time.monotonic() + _WORDS_S
                while not self.said and time.monotonic() < words:
                    await asyncio.sleep(_POLL_S)
                why = self.said or "its worker process gives no answer"
                raise DeviceUnavailable(str(self._source.error(("drivers", self.name), why)))
            await asyncio.sleep(_POLL_S)

    async def _listen(self, say: Callable[[str], None]) -> None:
        async for document in self._child.answers():
            self._take(document, say)
        if said := (await self._child.complaint()).strip():
            self.said = said.splitlines()[-1]

    def _take(self, document: dict[str, Any], say: Callable[[str], None]) -> None:
        event = document["event"]
        if event == "statistics":
            self.counts, self.cpu_s = document["counts"], document["cpu_s"]
            return
        text, was_slow = str(document["text"]), self._is_slow
        self._is_slow = event == "opening"
        self._opening |= self._is_slow
        if event == "up":
            self.said = ""
            if self.image.ask(EPOCH) > 1 or self._child.starts > 1:
                say(f"driver {self.name}: link up; its outputs stay at rest until the axes are armed again")
        elif event in ("outputs", "opening"):
            if not (was_slow and self._is_slow):
                say(f"driver {self.name}: {text}")
        else:
            if event != "rights":
                self.said = text
            if event in ("latched", "lost") and self.image.ask(EPOCH) == 0:
                return  # it is said once, where `first_link` gives up
            if event == "latched":
                text += "; not tried again, mend it and restart"
            elif event == "lost":
                text = f"link lost: {text}; tried again in {1e3 * document['retry_s']:.0f} ms"
            say(f"WARNING: driver {self.name}: {text}")

    async def supervise(self, say: Callable[[str], None]) -> None:
        """Start the process again where it died or hangs, five times in a minute; then its link is latched."""
        while True:
            ended = await self._child.wait(_STUCK_S / 4)
            if self._ending:
                return
            if not ended:
                if self._hangs():
                    say(f"WARNING: driver {self.name}: its worker process hangs; it is killed")
                    self._child.kill()
                continue
            if self._listening is not None:
                await self._listening
            self.image.tell(LINK, LINK_DOWN)
            self.image.tell(OUTPUT_STATE, UNKNOWN)
            how = self._child.end if self._child.was_killed else f"{self._child.end}: {self.said}"
            if not self._restarts.allows(time.monotonic()):
                self.image.tell(LINK, LINK_LATCHED)
                say(f"WARNING: driver {self.name}: its worker process {how}; not started again, it died too often")
                return
            say(f"WARNING: driver {self.name}: its worker process {how}; started again")
            await self._start_again(say)

    async def _start_again(self, say: Callable[[str], None]) -> None:
        """Start the process as soon as the machine has what that takes: descriptors, memory, a process more."""
        told = False
        while not self._ending:
            try:
                return await self.start(say)
            except OSError as problem:
                if not told:
                    say(f"WARNING: driver {self.name}: no new process: {problem.strerror}; tried again each second")
                told = True
            await asyncio.sleep(_AGAIN_S)
        return None

    def _has_begun(self) -> bool:
        return self.image.ask(ALIVE_NS) * 1e-9 > self._started

    def _hangs(self) -> bool:
        if not self._has_begun():
            return time.monotonic() - self._started > _START_S
        alive = max(self.image.ask(ALIVE_NS) * 1e-9, self._started + _FIRST_LINK_S)
        stuck_s = _STUCK_S if self.image.ask(LINK) == LINK_UP else _FIRST_LINK_S  # a library may sleep as it opens
        return time.monotonic() - alive > stuck_s

    def adopt(self, prepared: Prepared) -> None:
        """Go by the limits and times of another configuration of the same outputs, from now on."""
        rules = _rules(prepared, self.name)
        if rules == self._orders["rules"]:
            return
        self._orders["rules"] = rules
        self.image.count_as_lost_after(rules["patience_ns"])
        self._child.send({"rules": rules})

    async def end(self) -> None:
        """Let the outputs come to rest and the process end; killed where it never had a link, or has no success."""
        self._ending = True
        if not self._child.starts:
            return
        self._child.end_orders()
        begin = time.monotonic()
        end_s = _END_S if self.image.ask(EPOCH) else _NEVER_UP_S
        while not await self._child.wait(_STUCK_S / 4):
            if time.monotonic() - max(begin, self.image.ask(SENT_NS) * 1e-9) > end_s:
                self._child.kill()
        if self.image.ask(OUTPUT_STATE) != RESTING:
            self.image.tell(OUTPUT_STATE, UNKNOWN)
        if self._listening is not None:
            await self._listening

    @property
    def is_in_hand(self) -> bool:
        """Whether the device is at rest with its outputs in the loop's hand; a bus without outputs is."""
        followed = self.image.output_state == OUTPUT_NAMES[FOLLOWING]
        return not self._places or (followed and self.image.ask(AT_REST) != 0)

    @property
    def way_to_rest_s(self) -> float:
        """The longest that a device takes to its safe values once it is given them."""
        rules = self._orders["rules"]
        spans_s = [(each["high"] - each["low"]) / each["slew_V_per_s"] for each in rules["outputs"] if _slews(each)]
        return float(rules["ramp_s"] + max(spans_s, default=0.0))

    @property
    def rests(self) -> bool:
        """Whether the device has said to have its safe values; one that was never reached was given none."""
        return not self._places or self.image.ask(EPOCH) == 0 or self.image.ask(OUTPUT_STATE) == RESTING

    @property
    def outputs_text(self) -> str:
        """What people are told of the outputs with the loop dead."""
        if self.rests:
            return "outputs at their safe value"
        given = self._given()
        lasts = {name: "never given" if given[name] is None else f"last {given[name]:g} V" for name in self._voltages}
        return ", ".join(f"{name} unknown, {last}" for name, last in lasts.items()) or "outputs unknown"

    def _given(self) -> dict[str, float | None]:
        known = self.image.known(len(self._orders["rules"]["outputs"]))
        return {name: None if known is None else known[place] for name, place in self._places.items()}

    def report(self) -> Link:
        """Where the link stands."""
        sent_ns = self.image.ask(SENT_NS)
        return {
            "link": self.image.link,
            "outputs": self.image.output_state,
            "given": self._given(),
            "given_s_ago": round(time.monotonic() - sent_ns * 1e-9, 3) if sent_ns else None,
            "links": self.image.ask(EPOCH),
            "starts": self._child.starts,
            "message": self.said or None,
            "counts": dict(self.counts),
            "cpu_s": self.cpu_s,
        }


def _orders(prepared: Prepared, name: str, descriptor: int, offset: int) -> dict[str, Any]:
    configuration = prepared.configuration
    options = prepared.wiring.bus_options(name)
    return {
        "driver": configuration.drivers[name].driver,
        "options": options.model_dump_json(),
        "folder": str(prepared.source.path.parent),
        "memory": str(device_lock.FOLDER),
        "descriptor": descriptor,
        "offset": offset,
        "rules": _rules(prepared, name),
        "loop_cpu": configuration.loop.cpu,
        "cpu": options.cpu,
        "priority": max(1, configuration.loop.priority - _BELOW_LOOP),
    }


def _rules(prepared: Prepared, name: str) -> dict[str, Any]:
    """What the worker goes by that can be changed while it runs (``micromanip.bus.worker.Rules``)."""
    configuration = prepared.configuration
    return {
        "outputs": [asdict(output) for output in prepared.wiring.safe_outputs(name, configuration)],
        "ramp_s": configuration.start.ramp_s,
        "dead_ns": round(configuration.faults.link.loop_silent_ms * 1e6),
        "patience_ns": round(configuration.faults.link.silent_ms * 1e6),
    }


def _slews(output: dict[str, Any]) -> bool:
    return math.isfinite(output["high"] - output["low"]) and math.isfinite(output["slew_V_per_s"])
