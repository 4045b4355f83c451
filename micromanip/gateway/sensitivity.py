"""The sensitivity of a running loop for a browser: asked of the control socket, judged as the command does it.

The browser asks for its measurement again and again. Where it goes away nobody does so, and the controller lets the
injection fade within a second.
"""

from __future__ import annotations

import asyncio
import math
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

from micromanip.errors import UsageError
from micromanip.replies import Injected, Response

from .cell import Cell

_KEPT = 16
_BEGINS, _LOOKS = {"axis", "loop", "amplitude_um", "seed"}, {"number", "with"}


class SensitivityMeasurements:
    """The newest measurements of one cell, by all browsers."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._begun: OrderedDict[int, tuple[str, str, Injected]] = OrderedDict()
        self._found: dict[int, Response] = {}

    async def ask(self, name: str, query: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a measurement (`axis`, `loop`, `amplitude_um`, `seed`), or see where `number` stands.

        Once that is done, what it says `with` earlier ones of the same loop is `found`, or `problem` says why nothing
        can be read off. Raises what the controller answers, UsageError where the request makes no sense.
        """
        if not set(query) <= (_LOOKS if "number" in query else _BEGINS):
            raise UsageError(f"sensitivity takes {', '.join(sorted(_BEGINS))}, or {' and '.join(sorted(_LOOKS))}")
        if "number" in query:
            return await self._look(name, query)
        begun: Injected = await self._cell.order("analyse_live", name, **query)
        self._begun[begun["number"]] = (str(query["axis"]), str(query.get("loop", "strain")), begun)
        while len(self._begun) > _KEPT:
            self._found.pop(self._begun.popitem(last=False)[0], None)
        return {"number": begun["number"], "seconds": begun["seconds"]}

    async def _look(self, name: str, query: Mapping[str, Any]) -> dict[str, Any]:
        number, others = query["number"], query.get("with", [])
        if not isinstance(others, list) or len(others) > _KEPT:
            raise UsageError(f"with is a list of up to {_KEPT} numbers of measurements")
        response: Response = await self._cell.order("analyse_live", name, number=number)
        answer = {"number": number, "done": response["done"], "progress": response["progress"]}
        if not response["done"]:
            return answer
        if number not in self._begun:
            raise UsageError(f"measurement {number} was not begun here")
        self._found[number] = response
        axis, loop, begun = self._begun[number]
        known = [k for k in others if isinstance(k, int) and k in self._found and self._begun[k][:2] == (axis, loop)]
        judged = await asyncio.to_thread(_judged, begun, [*(self._found[k] for k in known), response], axis, loop)
        return answer | judged


def _judged(begun: Injected, responses: list[Response], axis: str, loop: str) -> dict[str, Any]:
    from micromanip.design.analyse.live_margins import document, judge_answers
    from micromanip.errors import CheckFailed

    try:
        return {"found": _plain(document(judge_answers(begun, responses, axis, loop), loop)), "problem": None}
    except CheckFailed as problem:
        return {"found": None, "problem": str(problem)}


def _plain(value: Any) -> Any:
    """The same without infinities, which JSON has no word for: a margin without an end is None."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
