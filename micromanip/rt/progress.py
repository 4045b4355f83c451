"""How far numba is with an entry point, and how long the rest will take."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

_PARTS_SHARE = 0.7
"""Of the time that an entry point takes; the optimiser has the rest, which can't be watched."""
_EVERY_S, _FIRST_S, _SAYS_LITTLE = 3.0, 2.0, 0.05


class Progress:
    """Counts the functions that are built into an entry point, by the length of their code."""

    current: ClassVar[Progress | None] = None
    """Of the entry point that is compiled at present, under numba's lock."""

    def __init__(self, function: Any, tell: Callable[[str, float], None]) -> None:
        """`tell` gets the name of `function` and the seconds that are left, now and then."""
        self._name, self._tell = function.__name__, tell
        self._left = {each: len(each.__code__.co_code) for each in _built_into(function)}
        self._all = sum(self._left.values())
        self._began = time.monotonic()
        self._next_s = self._began + _FIRST_S

    def compiled(self, function: Any) -> None:
        """`function` is ready to be built in."""
        self._left.pop(function, None)
        now = time.monotonic()
        share = _PARTS_SHARE * (1.0 - sum(self._left.values()) / self._all)
        if now >= self._next_s and share > _SAYS_LITTLE:
            self._next_s = now + _EVERY_S
            self._tell(self._name, (now - self._began) * (1.0 - share) / share)


def _built_into(function: Any) -> set[Any]:
    """The Python functions that the compiled `function` calls, and those that these call; with itself."""
    found, ahead = set(), [function]
    while ahead:
        each = ahead.pop()
        if each not in found:
            found.add(each)
            ahead += _called(each)
    return found


def _called(function: Any) -> Iterator[Any]:
    for name in function.__code__.co_names:
        inner = getattr(function.__globals__.get(name), "py_func", None)
        if hasattr(inner, "__code__"):
            yield inner
