"""What a configuration says of a frame, as the table that compiled code walks (``rt/io/frames.py``); its counter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micromanip.errors import ConfigError
from micromanip.rt.io.counting import COUNTED, OLD, missing_before
from micromanip.rt.io.frames import FRAME, MAX_BYTES, MAX_GOOD, MAX_GROUPS, RULES, checksum
from micromanip.rt.io.numbers import FLOATING, SIGNED, UNSIGNED
from micromanip.rt.record import move
from micromanip.rt.records import MAX_SIGNALS

from .number_options import number_range

_MOST_COUNTS, _TRIALS = 1 << 32, 32
"""Of a wider counter the lowest bits count as well."""


@dataclass(frozen=True)
class GroupPlan:
    """Numbers that are sampled together; `fields` are numbers with scale and offset, outputs with a range too."""

    fields: Mapping[str, Any]
    counter: Any = None
    latency_ns: int = 0


@dataclass(frozen=True)
class FramePlan:
    """One kind of frame. Group 0 comes with each; `head` are its first bytes.

    The rest are keys of the configuration, None for what the frame has not: numbers with ``at``, ``size``, ``type`` and
    ``byte_order``; of the status also the ``mask`` (None: all bits) and the ``good`` values of what is left; of the
    checksum at the end ``size``, ``byte_order``, the ``first`` byte that it covers, and its ``function`` of them.
    """

    length: int
    groups: Sequence[GroupPlan]
    head: bytes = b""
    checksum: Any = None
    counter: Any = None
    clock: Any = None
    status: Any = None
    acknowledged: Any = None

    def record(self) -> NDArray[np.void]:
        """The table, an array of one FRAME. Raises ConfigError for what it has no room for."""
        frames = np.zeros(1, FRAME)
        frame = frames[0]
        fields = [(k, field) for k, group in enumerate(self.groups) for field in group.fields.values()]
        for what, count, most in (
            ("bytes", self.length, MAX_BYTES),
            ("fields", len(fields), MAX_SIGNALS),
            ("groups", len(self.groups), MAX_GROUPS),
            ("good values of its status", len(self.status.good) if self.status else 0, MAX_GOOD),
        ):
            if count > most:
                raise ConfigError(f"{count} {what} in a datagram, at most {most} are possible")
        frame["length"] = self.length
        frame["template"][: len(self.head)] = np.frombuffer(self.head, np.uint8)
        frame["fixed"][: len(self.head)] = 1
        for place in ("counter", "acknowledged", "clock", "status"):
            fill_number(frame[place], getattr(self, place))
        if self.status is not None:
            frame["mask"] = (1 << (8 * self.status.size)) - 1 if self.status.mask is None else self.status.mask
            frame["goods"] = len(self.status.good)
            frame["good"][: len(self.status.good)] = self.status.good
        frame["groups"], frame["numbers"] = len(self.groups), len(fields)
        for group, plan in zip(frame["group"], self.groups, strict=False):
            fill_number(group["counter"], plan.counter)
            group["latency_ns"] = plan.latency_ns
        for i, (k, field) in enumerate(fields):
            fill_number(frame["number"][i], field)
            frame["group_of"][i] = k
        if self.checksum is not None:
            _fill_checksum(frame, self.checksum)
        return frames


def fill_number(number: Any, keys: Any) -> None:
    """Put the keys of a number, None for one that is not there, into a NUMBER record."""
    if keys is None:
        return
    kind = {"f": FLOATING, "i": SIGNED, "u": UNSIGNED, "b": UNSIGNED}[keys.type[0]]
    number["present"], number["at"], number["size"], number["kind"] = 1, keys.at, keys.size, kind
    number["big"] = keys.byte_order == "big"
    number["bit"], number["bits"] = getattr(keys, "bit", 0), getattr(keys, "bits", 8 * keys.size)
    scale, offset = float(getattr(keys, "scale", 1.0)), float(getattr(keys, "offset", 0.0))
    number["scale"], number["offset"] = scale, offset
    number["lowest_code"], number["highest_code"] = codes = number_range(keys.type)
    ends = sorted(end * scale + offset for end in codes)
    number["low"], number["high"] = getattr(keys, "range", None) or ends


def _fill_checksum(frame: Any, keys: Any) -> None:
    """Make the table by what the function does with single bytes, and see that both agree.

    Raises ConfigError for a checksum that no such table can compute.
    """
    c, function = frame["checksum"], keys.function
    c["size"], c["first"], c["big"] = keys.size, keys.first, keys.byte_order == "big"
    nothing = function(b"\0")
    c["table"] = [function(bytes([byte])) ^ nothing for byte in range(256)]
    covered = int(frame["length"]) - keys.size - keys.first
    c["constant"] = function(bytes(covered))
    trials = np.random.default_rng(1).integers(0, 256, (_TRIALS, int(frame["length"])), np.uint8)
    expected = [function(trial[keys.first : keys.first + covered].tobytes()) for trial in trials]
    for c["rule"] in RULES:
        if [int(checksum(frame, trial)) for trial in trials] == expected:
            return
    raise ConfigError(f"{keys.name} takes its bits in one order and gives them in another, which is not supported")


class DeviceCounter:
    """The counter of a device's packets, which begins anew after `counts`: Python and compiled code share a record."""

    def __init__(self, counts: int) -> None:
        self.record = np.zeros(1, COUNTED)[0]
        self.record["counts"] = min(counts, _MOST_COUNTS)

    def move_to(self, record: Any) -> None:
        """Count in this record from now on, from where it stands."""
        self.record = move(self.record, record)

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self.record["known"] = self.record["in_a_row"] = 0

    def lost_before(self, count: int, step: int = 1) -> int | None:
        """What is known to be missing before `count`, where the one after it is `step` further; None: it is not fresh.

        A device that has begun anew is fresh, and nothing is known to be missing.
        """
        missing = int(missing_before(self.record, count % int(self.record["counts"]), step))
        return None if missing == OLD else max(0, missing)

    def counted(self, name: str) -> int:
        """What was counted: lost, doubled, late, restarts."""
        return int(self.record[name])
