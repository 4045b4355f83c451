"""A configuration's terminal as a slave: what its PDOs map, and where each number of its process data lies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from .terminal import Entry, Terminal


@dataclass(frozen=True)
class Number:
    """A number of a terminal's process data, as ``FramePlan`` takes it; EtherCAT's byte order is little."""

    at: int
    size: int
    type: str
    scale: float
    offset: float
    range: tuple[float, float] | None
    byte_order: str = "little"


def numbers(pdos: Mapping[str, Any]) -> Iterator[tuple[str, Number]]:
    """One behind the other, by channel."""
    at = 0
    for pdo in pdos.values():
        for name, field in pdo.fields.items():
            yield name, Number(at, field.size, field.type, field.scale, field.offset, getattr(field, "range", None))
            at += field.size


def terminal_of(name: str, keys: Any) -> Terminal:
    """The slave that the configuration expects; revision and serial number are 1 where it says nothing."""
    outputs, inputs = ({pdo.pdo: _entries(pdo) for pdo in pdos.values()} for pdos in (keys.outputs, keys.inputs))
    settings = {(each.index, each.subindex): bytes(each.size) for each in keys.settings.values()}
    revision = 1 if keys.revision is None else keys.revision
    serial = 1 if keys.serial is None else keys.serial
    is_drive = keys.drive is not None
    return Terminal(name, keys.vendor, keys.product, revision, serial, outputs, inputs, settings, is_drive)


def _entries(pdo: Any) -> list[Entry]:
    return [Entry(field.index, field.subindex, 8 * field.size, name) for name, field in pdo.fields.items()]
