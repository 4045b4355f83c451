"""A quantity over time in one line of text: a bar for each look, empty where it was not known."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

_BARS = "▁▂▃▄▅▆▇█"


def bars(values: Iterable[float | None], highest: float) -> str:
    """One character for each of `values` (none negative), which are drawn from 0 to `highest`."""
    return "".join(_bar(value, highest) for value in values)


def _bar(value: float | None, highest: float) -> str:
    if value is None:
        return " "
    place = 0 if highest <= 0 else int(len(_BARS) * value / highest)
    return _BARS[min(place, len(_BARS) - 1)]


class Trace:
    """The last values of one quantity, and a line of them with its scale."""

    def __init__(self, most: int = 400) -> None:
        self._values: deque[float | None] = deque(maxlen=most)

    def add(self, value: float | None) -> None:
        """What was seen now; None where it is not known."""
        self._values.append(value)

    def line(self, name: str, unit: str, width: int) -> str:
        """The newest values that fit into `width` characters, right-aligned, and the highest of them."""
        room = max(1, width - len(self._label(name, unit, 0.0)) - 1)
        shown = list(self._values)[-room:]
        known = [value for value in shown if value is not None]
        highest = max(known, default=0.0)
        label = self._label(name, unit, highest if known else None)
        return f"{label} {bars(shown, highest).rjust(room)}"

    @staticmethod
    def _label(name: str, unit: str, highest: float | None) -> str:
        top = "unknown" if highest is None else f"{highest:.3g}"
        return f"{name} {top:>8} {unit}"
