"""A configuration's terminal as a slave: what its PDOs map. One whose fields are all bits is a digital terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .terminal import Entry, Terminal


def terminal_of(name: str, keys: Any) -> Terminal:
    """The slave that the configuration expects; revision and serial number are 1 where it says nothing."""
    outputs, inputs = ({pdo.pdo: _entries(pdo) for pdo in pdos.values()} for pdos in (keys.outputs, keys.inputs))
    settings = {(each.index, each.subindex): bytes(each.size) for each in keys.settings.values()}
    revision = 1 if keys.revision is None else keys.revision
    serial = 1 if keys.serial is None else keys.serial
    is_drive, is_digital = keys.drive is not None, not settings and _are_bits(outputs | inputs)
    return Terminal(name, keys.vendor, keys.product, revision, serial, outputs, inputs, settings, is_drive, is_digital)


def _entries(pdo: Any) -> list[Entry]:
    return [Entry(field.index, field.subindex, field.bits, name) for name, field in pdo.fields.items()]


def _are_bits(pdos: Mapping[int, Sequence[Entry]]) -> bool:
    return bool(pdos) and all(entry.bits == 1 for entries in pdos.values() for entry in entries)
