"""Samples on their way from a driver to the process image, and what the device has confirmed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass
class Sample:
    """One fresh reading of an input."""

    channel: int
    value: float
    time_ns: int
    """When it was taken, CLOCK_MONOTONIC."""
    status: int = 0
    """0 is good; anything else is the device's own word for "do not use"."""
    lost: int = 0
    """Samples that are known to be missing before it (a gap in the device's counter)."""


Readings = tuple[int, Sequence[float], int, int, int]
"""What was read at one moment: index of the first input, values of it and its neighbours, time_ns, status, lost."""


class Inbox:
    """Where a driver puts what it received; the worker empties it into the process image."""

    def __init__(self) -> None:
        self._readings: list[Readings] = []
        self._confirmed: list[int] = []
        self._remarks: list[str] = []
        self._samples = 0

    def remark(self, text: str) -> None:
        """Something of the device that people should know, and nothing else follows from; told each time."""
        self._remarks.append(text)

    def confirm(self, task: int) -> None:
        """The device has said that it took the outputs of that task, as they were sent last."""
        self._confirmed.append(task)

    def put(self, channel: int, value: float, time_ns: int, status: int = 0, lost: int = 0) -> None:
        """Add a fresh sample of the input with index `channel`; the newest of several wins, none is counted lost."""
        self._readings.append((channel, (value,), time_ns, status, lost))
        self._samples += 1

    def put_all(self, first: int, values: Sequence[float], time_ns: int, status: int = 0, lost: int = 0) -> None:
        """Add a fresh sample of each of the inputs from index `first` on, all taken at the same moment: a frame.

        The same as to ``put`` one after the other, in less time.
        """
        self._readings.append((first, values, time_ns, status, lost))
        self._samples += len(values)

    @property
    def readings(self) -> Sequence[Readings]:
        """What was put, in that order, not taken apart."""
        return self._readings

    @property
    def remarks(self) -> Sequence[str]:
        """What people should know."""
        return self._remarks

    def take_confirmed(self) -> list[int]:
        """Tasks whose outputs the device has confirmed since the last call."""
        confirmed, self._confirmed = self._confirmed, []
        return confirmed

    @property
    def lost(self) -> int:
        """Samples that are known to be missing, of all inputs together."""
        return sum(lost * len(values) for _, values, _, _, lost in self._readings)

    def __iter__(self) -> Iterator[Sample]:
        for first, values, time_ns, status, lost in self._readings:
            for channel, value in enumerate(values, first):
                yield Sample(channel, value, time_ns, status, lost)

    def __len__(self) -> int:
        return self._samples

    def clear(self) -> None:
        """Forget what was taken over."""
        self._readings.clear()
        self._confirmed.clear()
        self._remarks.clear()
        self._samples = 0
