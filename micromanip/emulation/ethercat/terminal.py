"""What kind of slave it is: its identity, what its PDOs map, and its other objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from micromanip.bus.ethercat.process_data import bytes_of

MAILBOX_BYTES = 128
MAILBOX_OUT, MAILBOX_IN, OUTPUTS, INPUTS = 0x1000, 0x1080, 0x1100, 0x1800
"""Where mailboxes and process data lie in the memory of an emulated slave."""
DIGITAL_OUTPUTS, DIGITAL_INPUTS = 0x0F00, 0x1000
"""Where the process data of one without a processor lie: the register of its pins, and the first of its memory."""


@dataclass(frozen=True)
class Area:
    """Process data of one direction: which sync manager they have, where they begin, its control byte."""

    manager: int
    start: int
    control: int


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

    `settings` are objects of its own, (index, subindex) to bytes, that a master may write.
    One that `is_digital` has no processor: no mailbox, its pins are bits of the controller itself.
    """

    name: str
    vendor: int
    product: int
    revision: int
    serial: int
    outputs: Mapping[int, Sequence[Entry]] = field(default_factory=dict)
    inputs: Mapping[int, Sequence[Entry]] = field(default_factory=dict)
    settings: Mapping[tuple[int, int], bytes] = field(default_factory=dict)
    is_digital: bool = False

    @property
    def output_area(self) -> Area:
        """Of its outputs."""
        return Area(0, DIGITAL_OUTPUTS, 0x44) if self.is_digital else Area(2, OUTPUTS, 0x64)

    @property
    def input_area(self) -> Area:
        """Of its inputs."""
        if self.is_digital:
            return Area(int(self.output_bytes > 0), DIGITAL_INPUTS, 0x00)
        return Area(3, INPUTS, 0x20)

    @property
    def output_bytes(self) -> int:
        """Length of its outputs."""
        return _bytes(self.outputs)

    @property
    def input_bytes(self) -> int:
        """Length of its inputs."""
        return _bytes(self.inputs)


def _bytes(pdos: Mapping[int, Sequence[Entry]]) -> int:
    return bytes_of(entry.bits for entries in pdos.values() for entry in entries)


def terminal_of(name: str, keys: Any) -> Terminal:
    """The slave that the configuration expects; revision and serial number are 1 where it says nothing."""
    outputs, inputs = ({pdo.pdo: _entries(pdo) for pdo in pdos.values()} for pdos in (keys.outputs, keys.inputs))
    settings = {(each.index, each.subindex): bytes(each.size) for each in keys.settings.values()}
    revision = 1 if keys.revision is None else keys.revision
    serial = 1 if keys.serial is None else keys.serial
    is_digital = not settings and _are_bits(outputs | inputs)
    return Terminal(name, keys.vendor, keys.product, revision, serial, outputs, inputs, settings, is_digital)


def _entries(pdo: Any) -> list[Entry]:
    return [Entry(field.index, field.subindex, field.bits, name) for name, field in pdo.fields.items()]


def _are_bits(pdos: Mapping[int, Sequence[Entry]]) -> bool:
    return bool(pdos) and all(entry.bits == 1 for entries in pdos.values() for entry in entries)
