"""One thing that was judged: a page or a catalogue reads such findings without what it takes to make them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Criterion:
    """``name`` of what was judged, whether it ``passed``, the ``value`` found and the ``limit`` in words.

    ``acceptance``: it asks for accuracy alone; an axis that misses it is less good, and no less safe.
    """

    axis: str
    name: str
    passed: bool
    value: str
    limit: str
    acceptance: bool = False
