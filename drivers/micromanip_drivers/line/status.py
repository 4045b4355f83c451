"""The device's own word on whether its values are good."""

from __future__ import annotations

from .field_options import Status
from .number import NumberCodec

_BAD = -1
"""Status of samples whose device says 0, and 0 is not good."""


class StatusWord:
    """A number of a frame as the status of its samples: 0 is good."""

    def __init__(self, options: Status) -> None:
        self._codec = NumberCodec(options)
        self._mask = (1 << (8 * options.size)) - 1 if options.mask is None else options.mask
        self._good = frozenset(options.good)

    def of(self, frame: bytes) -> int:
        """0, or the device's word for what is wrong."""
        word = int(self._codec.read(frame)) & self._mask
        return 0 if word in self._good else word or _BAD
