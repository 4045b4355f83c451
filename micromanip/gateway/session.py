"""One browser on the live connection: what it wants to see, and how much it can take.

It says what it has drawn; at most two messages are on their way to it, and a status. One that is slow or frozen is sent
nothing meanwhile, and then what is newest: there is no queue. Messages of the browser are JSON, with a `type`:

`hello` (first: token, page), `view` (fields, span_s, points; last: cycle, null follows), `trigger` (or null), `arm` the
trigger again, `spectrum`, `xy`, `drawn`. What comes back: `hello`, `status`, `problem` as JSON, `frame`, `spectrum`,
`xy` as binary (`frames`).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Awaitable, Callable
from typing import Any

from micromanip.errors import MicromanipError, UsageError
from micromanip.rt.states import STATE_NAMES

from .cell import Cell, Rows, Source
from .tokens import Token
from .trigger import Condition, Trigger
from .views import View, frame_of, number, spectrum_of, xy_of

MESSAGE_BYTES = 16_384
_ON_THE_WAY = 2
"""Traces; a status may be one more, so that a fault does not wait until a trace is drawn."""
_FRAME_S = 0.05
"""From one trace to the next at least; a status waits for nothing."""
_LEAST_PATIENCE_S = 0.5

Send = Callable[[str | bytes], Awaitable[None]]


class Session:
    """Serves one browser, as long as `run` does; `hear` gets its messages."""

    def __init__(self, cell: Cell, token: Token, send: Send, differs: Callable[[], str | None]) -> None:
        """`differs` says so where the controller runs another configuration than was expected, else None."""
        self._cell, self._token, self._send, self._differs = cell, token, send, differs
        self._source: Source | None = None
        self._view = View()
        self._trigger: Trigger | None = None
        self._trigger_query: Any = None
        self._wanted: set[str] = {"status"}
        self._asked: list[dict[str, Any]] = []
        self._on_the_way = 0
        self._number = 0
        self._shown: int | None = None
        self._is_greeted = False
        self._wake, self._has_status = asyncio.Event(), asyncio.Event()
        self._wake.set()

    async def run(self) -> None:
        """Send what there is to send, for ever."""
        self._cell.listeners.add(self._heard)
        try:
            while True:
                await self._wake.wait()
                self._wake.clear()
                begin = time.monotonic()
                said = await self._say_next()
                if said is not None:
                    self._wake.set()
                if isinstance(said, bytes):
                    rest_s = _FRAME_S - (time.monotonic() - begin)
                    with contextlib.suppress(TimeoutError):
                        await asyncio.wait_for(self._has_status.wait(), max(0.0, rest_s))
        finally:
            self._cell.listeners.discard(self._heard)

    def hear(self, text: str) -> None:
        """A message of the browser; UsageError where it makes no sense."""
        try:
            message = json.loads(text)
        except (ValueError, RecursionError):
            raise UsageError("not a message of JSON") from None
        kind = message.get("type") if isinstance(message, dict) else None
        if kind == "drawn":
            self._on_the_way = max(0, self._on_the_way - 1)
        elif kind == "view":
            self._view = View.read(message, self._source)
            self._set_trigger(self._trigger_query)
            self._wanted.add("frame")
        elif kind == "trigger":
            self._set_trigger(message.get("trigger"))
            self._wanted.add("frame")
        elif kind == "arm":
            if self._trigger is not None:
                self._trigger.arm()
        elif kind in ("spectrum", "xy"):
            self._asked = [other for other in self._asked if other["type"] != kind] + [message]
        else:
            raise UsageError(f"unknown message {kind!r:.40}")
        self._wake.set()

    def _set_trigger(self, query: Any) -> None:
        self._trigger_query = self._trigger = None
        if self._source is None or query is None:
            return
        condition = Condition.read(query, self._source.fields)
        share = number(query, "before", 0.0, 1.0)
        span = self._view.cycles(self._source)
        before = round(share * span)
        patience = max(span, round(_LEAST_PATIENCE_S * 1e9 / self._source.about["period_ns"]))
        self._trigger_query = query
        self._trigger = Trigger(condition, str(query.get("mode")), before, span - before, patience)

    def _heard(self, rows: Rows | None) -> None:
        if rows is None:
            self._wanted.add("status")
            self._has_status.set()
        elif self._source is self._cell.source and self._source is not None:
            if self._trigger is not None:
                self._trigger.add(rows)
            if self._view.follows:
                self._wanted.add("frame")
        self._wake.set()

    async def _say_next(self) -> str | bytes | None:
        """Send one message, if there is one and the browser can take it; what it was."""
        if not self._is_greeted or self._source is not self._cell.source:
            self._is_greeted, self._source, self._trigger = True, self._cell.source, None
            hello = json.dumps(self._hello())
            await self._send(hello)
            return hello
        if self._on_the_way >= _ON_THE_WAY + ("status" in self._wanted):
            return None
        if "status" in self._wanted:  # there is no pause between it and traces
            self._wanted.discard("status")
            self._has_status.clear()
            message: str | bytes | None = json.dumps(self._status())
        else:
            message = await self._traces()
        if message is not None:
            self._on_the_way += 1
            await self._send(message)
        return message

    async def _traces(self) -> str | bytes | None:
        if self._source is None:
            return None
        try:
            if self._asked:
                asked = self._asked.pop(0)
                make = spectrum_of if asked["type"] == "spectrum" else xy_of
                return await make(self._source, asked)
            return self._frame(self._source)
        except MicromanipError as problem:
            return json.dumps({"type": "problem", "problem": str(problem)})

    def _frame(self, source: Source) -> bytes | None:
        """What the view shows now; None where nothing is new."""
        if "frame" not in self._wanted or not self._view.fields:
            return None
        self._wanted.discard("frame")
        trigger, last, hit = self._trigger, self._view.last, None
        if self._view.follows and trigger is not None and not trigger.runs_free:
            if trigger.window is None:
                return None
            last, hit = trigger.window[1], trigger.cycle
            if trigger.mode != "single":
                trigger.arm()
            elif hit == self._shown:
                return None
            self._shown = hit
        self._number += 1
        return frame_of(source, self._view, last, {"number": self._number, "trigger_cycle": hit})

    def _hello(self) -> dict[str, Any]:
        source = self._source
        cell = None
        if source is not None:
            cell = {
                "axes": source.about["axes"],
                "range_V": source.about["range_V"],
                "period_ns": source.about["period_ns"],
                "fields": [{"name": field.name, "unit": field.unit} for field in source.fields],
                "states": STATE_NAMES,
                "recording": getattr(source, "recording", None),
            }
        return {"type": "hello", "name": self._token.name, "scope": self._token.scope, "cell": cell}

    def _status(self) -> dict[str, Any]:
        cell = self._cell
        return {
            "type": "status",
            "status": cell.status,
            "problem": cell.problem,
            "differs": self._differs(),
            "unseen": cell.unseen,
            "silent_s": 0.0 if cell.status is not None or not cell.heard_s else time.monotonic() - cell.heard_s,
        }
