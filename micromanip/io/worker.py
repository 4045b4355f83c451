"""What the worker of a bus does: opens the driver, does its tasks in time, keeps the outputs safe, comes back."""

from __future__ import annotations

import json
import math
import os
import random
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from micromanip.rt.image import ALIVE_NS, EPOCH, LINK, LINK_DOWN, LINK_LATCHED, LINK_UP, OUTPUT_STATE, RESTING

from .backoff import BackOff
from .bus import BusDriver, Inbox
from .bus_errors import BusError, IdentityMismatch, LinkError, OutputRefused, TransientError
from .image import ProcessImage
from .safe_state import SafeState
from .schedule import Schedule

LOOK_NS = 1_000_000
"""The worker looks whether the loop still lives so often at most; five times while that is in doubt."""
_REPORT_NS = 500_000_000
_ERRORS, _AMONG = 10, 40
"""So many errors among the last calls are a lost link."""
_COUNTERS = ("received", "lost", "performed", "errors", "refused", "links", "skipped")


class Worker:
    """Serves one driver until it is told to end."""

    def __init__(
        self,
        driver: BusDriver,
        image: ProcessImage,
        safe: SafeState,
        output_count: int,
        patience_ns: int = 0,
        look_ns: int = LOOK_NS,
        while_opening: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        """Errors that come and go are put up with for `patience_ns` before the link counts as lost.

        With nothing to do, it looks after the loop every `look_ns`; the driver is opened inside of `while_opening`.
        """
        self._look_ns, self._while_opening = look_ns, while_opening
        self._driver, self._image, self._safe = driver, image, safe
        self._values = np.zeros(len(image.wanted()[0]))  # as long as the image's, the driver's outputs first
        self._outputs = output_count
        self._decided_ns = 0
        self._inbox = Inbox()
        self._schedule = Schedule((), 0)
        self._failures: deque[bool] = deque(maxlen=_AMONG)
        self._patience_ns, self._good_ns = patience_ns, 0
        self._counts = dict.fromkeys(_COUNTERS, 0)
        self._reported_ns = 0
        self._ends = threading.Event()

    def end(self) -> None:
        """Come to an end: as soon as the loop is silent and the outputs are at rest."""
        self._ends.set()

    def run(self) -> None:
        """Keep the link up; returns when it is to end, raises what is a bug."""
        back_off = BackOff(random.Random())
        self._image.tell(ALIVE_NS, time.monotonic_ns())
        while not self._may_leave():
            opened = time.monotonic()
            try:
                self._serve()
            except IdentityMismatch as problem:
                self._lose(LINK_LATCHED)
                self._tell("latched", str(problem))
                self._wait(math.inf)
            except BusError as problem:
                self._lose(LINK_DOWN)
                wait_s = back_off.lost(time.monotonic() - opened)
                self._tell("lost", str(problem), retry_s=round(wait_s, 3))
                self._wait(wait_s)
            finally:
                self._driver.close()

    def _serve(self) -> None:
        """One life of the link: until an error, or the end."""
        with self._while_opening():
            self._driver.open()
        self._failures.clear()
        self._good_ns = time.monotonic_ns()
        self._inbox.clear()
        self._counts["links"] += 1
        self._schedule = Schedule(self._driver.tasks, time.monotonic_ns())
        self._image.tell(ALIVE_NS, time.monotonic_ns())
        self._image.tell(EPOCH, self._image.ask(EPOCH) + 1)
        self._image.tell(LINK, LINK_UP)
        self._tell("up", self._driver.device)
        while not self._may_leave():
            self._turn()
        self._part()

    def _part(self) -> None:
        """Leave the device with the safe values."""
        self._decide(time.monotonic_ns())
        for number, task in enumerate(self._driver.tasks):
            if task.outputs:
                self._driver.perform(number, self._values[: self._outputs].tolist(), self._inbox)

    def _turn(self) -> None:
        """Do what is due, or listen for a moment; hand over what came."""
        now_ns = time.monotonic_ns()
        task = self._schedule.take(now_ns)
        if task is not None or now_ns - self._decided_ns >= self._look_ns:
            self._decide(now_ns)
        failed = False
        try:
            if task is not None:
                self._driver.perform(task, self._values[: self._outputs].tolist(), self._inbox)
                self._counts["performed"] += 1
                if self._driver.tasks[task].outputs:
                    self._image.remember_sent(self._values, now_ns)
            else:
                due_ns = self._schedule.next_ns()
                look_ns = now_ns + self._look_ns
                self._driver.receive(self._inbox, look_ns if due_ns is None else min(due_ns, look_ns))
        except (TransientError, OutputRefused) as problem:
            failed = True
            self._counts["errors"] += 1
            self._judge(problem)
        if task is not None or failed or len(self._inbox) > 0:
            self._failures.append(failed)
            if sum(self._failures) < _ERRORS - 1:
                self._good_ns = now_ns
        self._hand_over()
        self._image.tell(ALIVE_NS, time.monotonic_ns())
        self._report(now_ns)

    def _judge(self, problem: BusError) -> None:
        impatient = time.monotonic_ns() - self._good_ns >= self._patience_ns
        if impatient and sum(self._failures) >= _ERRORS - 1:
            raise LinkError(f"{_ERRORS} errors in the last {_AMONG} calls; the last: {problem}") from problem

    def _hand_over(self) -> None:
        self._counts["received"] += len(self._inbox)
        self._counts["lost"] += self._inbox.lost
        self._image.publish(self._inbox)

    def _decide(self, now_ns: int) -> None:
        """What the device is to be given now."""
        wanted, written_ns = self._image.wanted()
        was = self._safe.state
        self._values[: self._outputs] = self._safe.values(wanted[: self._outputs], written_ns, now_ns)
        self._decided_ns = now_ns
        if self._safe.state != was:
            self._image.tell(OUTPUT_STATE, self._safe.state)

    def _lose(self, link: int) -> None:
        self._image.tell(LINK, link)
        self._safe.leave(time.monotonic_ns())
        self._image.tell(OUTPUT_STATE, self._safe.state)

    def _wait(self, seconds: float) -> None:
        """Let time pass without a link; the safe state goes on by the clock."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self._may_leave():
            now_ns = time.monotonic_ns()
            self._decide(now_ns)
            self._image.tell(ALIVE_NS, now_ns)
            self._report(now_ns)
            time.sleep(min(0.005, max(0.0, end - time.monotonic())))

    def _may_leave(self) -> bool:
        if not self._ends.is_set():
            return False
        _, written_ns = self._image.wanted()
        return self._safe.state == RESTING and self._safe.is_dead(written_ns, time.monotonic_ns())

    def _report(self, now_ns: int) -> None:
        if now_ns - self._reported_ns < _REPORT_NS:
            return
        self._reported_ns = now_ns
        self._counts["refused"], self._counts["skipped"] = self._safe.refused, self._schedule.skipped
        counts = {**self._counts, **self._driver.statistics()}
        say({"event": "statistics", "counts": counts, "cpu_s": round(time.process_time(), 3)})

    def _tell(self, event: str, text: str, **more: Any) -> None:
        say({"event": event, "text": text, **more})


def say(document: dict[str, Any]) -> None:
    """Tell the host, a JSON document a line."""
    try:
        os.write(1, json.dumps(document).encode() + b"\n")
    except (BlockingIOError, BrokenPipeError):
        return  # nobody listens, or not fast enough: the bus comes first
