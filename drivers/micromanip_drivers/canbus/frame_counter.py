"""The counter that a device puts into each frame: what is new, what is missing, what stands still."""

from __future__ import annotations

_RESTARTED_AFTER = 3
"""So many frames in a row that go on from a count in the past: the device began anew, it is no reordering."""


class FrameCounter:
    """Follows the counter of one message.

    A count that was there already is no news: the device repeats itself, or is frozen. One from the past, by less than
    half of the counter's range, was overtaken on its way. Neither is a fresh sample.
    """

    def __init__(self, bits: int) -> None:
        self._modulus = 1 << bits
        self._last: int | None = None
        self._past: int | None = None
        self._in_order = 0
        self.lost = self.repeated = self.out_of_order = self.restarts = 0

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self._last = self._past = None

    def lost_before(self, count: int) -> int | None:
        """Frames known to be missing before the one with this count; None for a frame that is not fresh."""
        if self._last is None:
            self._last = count
            return 0
        ahead = (count - self._last) % self._modulus
        if ahead == 0:
            self.repeated += 1
            return None
        if ahead > self._modulus // 2:
            return self._from_the_past(count)
        self._last, self._past = count, None
        self.lost += ahead - 1
        return ahead - 1

    def _from_the_past(self, count: int) -> int | None:
        goes_on = self._past is not None and count == (self._past + 1) % self._modulus
        self._in_order = self._in_order + 1 if goes_on else 1
        self._past = count
        if self._in_order <= _RESTARTED_AFTER:
            self.out_of_order += 1
            return None
        self.restarts += 1
        self._last, self._past = count, None
        return 0
