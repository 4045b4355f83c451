"""The keys of a configuration that an ESI device leads to: its identity, and the PDOs assigned from the start."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from micromanip.bus.number_options import BITS

from .esi import TYPES, EsiDevice, EsiEntry, EsiPdo

_GAP_TYPES = {bits: kind for kind, bits in BITS.items() if kind.startswith(("u", "b"))}


def terminal_keys(device: EsiDevice, taken: set[str]) -> tuple[str, dict[str, Any]]:
    """Name and keys of a terminal, as ``drivers.NAME.terminals`` has them; fields get names that are not `taken`."""
    keys: dict[str, Any] = {"vendor": device.vendor, "product": device.product}
    if device.revision is not None:
        keys["revision"] = device.revision
    for direction, pdos in (("outputs", device.outputs), ("inputs", device.inputs)):
        assigned = [pdo for pdo in pdos if pdo.sync_manager is not None]
        names: set[str] = set()
        if of_direction := {
            _name(pdo.name, names): {"pdo": pdo.index, "fields": fields}
            for pdo in assigned
            if (fields := _fields(pdo, taken))
        }:
            keys[direction] = of_direction
    return _name(device.name, set()), keys


def not_mapped(device: EsiDevice) -> Iterator[tuple[EsiPdo, EsiEntry]]:
    """What its PDOs have that can't be a field: of an unknown type, or of other bits than its type has."""
    for pdo in (*device.outputs, *device.inputs):
        if pdo.sync_manager is not None:
            yield from ((pdo, entry) for entry in pdo.entries if _type(entry) is None)


def lines_of(name: str, keys: dict[str, Any]) -> Sequence[str]:
    """The same as lines of YAML, below ``terminals:``."""
    lines = [f"{name}:", *(f"  {key}: 0x{keys[key]:x}" for key in ("vendor", "product", "revision") if key in keys)]
    for direction in ("outputs", "inputs"):
        pdos = keys.get(direction, {})
        lines += [f"  {direction}:"] if pdos else []
        for pdo_name, pdo in pdos.items():
            lines += [f"    {pdo_name}:", f"      pdo: 0x{pdo['pdo']:04x}", "      fields:"]
            for field_name, f in pdo["fields"].items():
                entry = f"{{index: 0x{f['index']:04x}, subindex: {f['subindex']}, type: {f['type']}}}"
                lines.append(f"        {field_name}: {entry}")
    return lines


def _fields(pdo: EsiPdo, taken: set[str]) -> dict[str, dict[str, Any]]:
    return {
        _name(entry.name or "gap", taken): {"index": entry.index, "subindex": entry.subindex, "type": kind}
        for entry in pdo.entries
        if (kind := _type(entry)) is not None
    }


def _type(entry: EsiEntry) -> str | None:
    if entry.index == 0:
        return _GAP_TYPES.get(entry.bits)
    kind = TYPES.get(entry.type)
    return kind if kind is not None and BITS[kind] == entry.bits else None


def _name(said: str, taken: set[str]) -> str:
    """As keys are written, and not `taken`, to which it is added."""
    plain = re.sub(r"[^a-z0-9]+", "_", said.lower()).strip("_")[:40] or "unnamed"
    plain = plain if plain[0].isalpha() else f"n{plain}"
    name, number = plain, 1
    while name in taken:
        number += 1
        name = f"{plain}_{number}"
    taken.add(name)
    return name
