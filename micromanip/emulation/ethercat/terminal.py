"""What kind of slave it is: its identity, what its PDOs map, and its other objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

MAILBOX_BYTES = 128
MAILBOX_OUT, MAILBOX_IN, OUTPUTS, INPUTS = 0x1000, 0x1080, 0x1100, 0x1800
"""Where mailboxes and process data lie in the memory of an emulated slave."""


@dataclass(frozen=True)
class Entry:
    """An object in a PDO; index 0 for a gap."""

    index: int
    subindex: int
    bits: int
    name: str = ""

    @property
    def mapping(self) -> int:
        """As objects 0x1600.. and 0x1A00.. hold it."""
        return self.index << 16 | self.subindex << 8 | self.bits


@dataclass(frozen=True)
class Terminal:
    """A slave: `outputs` and `inputs` are its PDOs (0x1600.., 0x1A00..) with what they map.

    `settings` are objects of its own, (index, subindex) to bytes, that a master may write; those of a drive come
    on top.
    """

    name: str
    vendor: int
    product: int
    revision: int
    serial: int
    outputs: Mapping[int, Sequence[Entry]] = field(default_factory=dict)
    inputs: Mapping[int, Sequence[Entry]] = field(default_factory=dict)
    settings: Mapping[tuple[int, int], bytes] = field(default_factory=dict)
    is_drive: bool = False

    @property
    def output_bytes(self) -> int:
        """Length of its outputs."""
        return _bytes(self.outputs)

    @property
    def input_bytes(self) -> int:
        """Length of its inputs."""
        return _bytes(self.inputs)


def _bytes(pdos: Mapping[int, Sequence[Entry]]) -> int:
    return sum(entry.bits for entries in pdos.values() for entry in entries) // 8
