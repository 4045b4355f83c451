"""The keys of a configuration that an ESI device leads to: its identity, and of the PDOs assigned from the start those
of use.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from .esi import EsiDevice, EsiEntry, EsiPdo
from .esi_document import field_type, unsigned_type
from .process_data import in_first_area


def terminal_keys(device: EsiDevice, taken: set[str]) -> tuple[str, dict[str, Any]]:
    """Name and keys of a terminal, as ``drivers.NAME.terminals`` has them; fields get names that are not `taken`."""
    keys: dict[str, Any] = {"vendor": device.vendor, "product": device.product}
    if device.revision is not None:
        keys["revision"] = device.revision
    for direction, pdos in (("outputs", device.outputs), ("inputs", device.inputs)):
        names: set[str] = set()
        if of_direction := {
            _name(pdo.name, names): {"pdo": pdo.index, "fields": fields}
            for pdo in begun_with(device, pdos)
            if (fields := _fields(pdo, taken))
        }:
            keys[direction] = of_direction
    return _name(device.name, set()), keys


def not_mapped(device: EsiDevice) -> Iterator[tuple[EsiPdo, EsiEntry]]:
    """What its PDOs have that can't be a field: of more bits than a number has."""
    yield from ((pdo, entry) for pdo, entry in _entries(device) if unsigned_type(entry.bits) is None)


def remarks(device: EsiDevice) -> Iterator[str]:
    """What the keys do not say, or not as the file has it."""
    if device.has_slots:
        yield "it has slots: PDOs of the modules in them are not read, and are to be added"
    yield from why_not(device)
    for pdo, entry in _entries(device):
        what = f"0x{entry.index:04x}:{entry.subindex:02x} {entry.name}, {entry.bits} bits {entry.type}".rstrip()
        if unsigned_type(entry.bits) is None:
            yield f"PDO 0x{pdo.index:04x}: no field for {what}: there is no type of so many bits"
        elif entry.index and field_type(entry.type, entry.bits) is None:
            yield f"PDO 0x{pdo.index:04x}: {what} is spare: its type is not known, or has other bits"
        elif entry.scale:
            yield f"PDO 0x{pdo.index:04x}: {what} stands for {entry.scale}, says the file"


def _entries(device: EsiDevice) -> Iterator[tuple[EsiPdo, EsiEntry]]:
    for pdos in (device.outputs, device.inputs):
        yield from ((pdo, entry) for pdo in begun_with(device, pdos) for entry in pdo.entries)


def lines_of(name: str, keys: dict[str, Any]) -> Sequence[str]:
    """The same as lines of YAML, below ``terminals:``."""
    lines = [f"{name}:", *(f"  {key}: 0x{keys[key]:x}" for key in ("vendor", "product", "revision") if key in keys)]
    for direction in ("outputs", "inputs"):
        pdos = keys.get(direction, {})
        lines += [f"  {direction}:"] if pdos else []
        for pdo_name, pdo in pdos.items():
            lines += [f"    {pdo_name}:", f"      pdo: 0x{pdo['pdo']:04x}", "      fields:"]
            for field_name, f in pdo["fields"].items():
                spare = ", spare: true" if "spare" in f else ""
                entry = f"index: 0x{f['index']:04x}, subindex: {f['subindex']}, type: {f['type']}{spare}"
                lines.append(f"        {field_name}: {{{entry}}}")
    return lines


def _fields(pdo: EsiPdo, taken: set[str]) -> dict[str, dict[str, Any]]:
    fields: dict[str, dict[str, Any]] = {}
    for entry in pdo.entries:
        known = field_type(entry.type, entry.bits) if entry.index else unsigned_type(entry.bits)
        if (kind := known or unsigned_type(entry.bits)) is not None:
            keys = {"index": entry.index, "subindex": entry.subindex, "type": kind}
            fields[_name(entry.name or "gap", taken)] = keys if known is not None else keys | {"spare": True}
    return fields


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


def begun_with(device: EsiDevice, pdos: Sequence[EsiPdo]) -> Sequence[EsiPdo]:
    """Those of one direction, in their order."""
    begun: list[EsiPdo] = []
    for pdo in pdos:
        if pdo.sync_manager is not None and _clash(pdo, begun) is None:
            begun.append(pdo)
    outside = {id(pdo) for pdo in apart(device, begun)}
    return [pdo for pdo in begun if id(pdo) not in outside]


def apart(device: EsiDevice, pdos: Sequence[EsiPdo]) -> Iterator[EsiPdo]:
    """Those of one direction that lie in another area than the first of them."""

    def begins_after(manager: int, before: int, bits: int) -> bool:
        return bits % 8 == 0 and _start(device, manager) == _start(device, before) + bits // 8

    placed = [(pdo, pdo.sync_manager) for pdo in pdos if pdo.sync_manager is not None]
    sizes = ((manager, sum(entry.bits for entry in pdo.entries)) for pdo, manager in placed)
    for (pdo, _), lies_there in zip(placed, in_first_area(sizes, begins_after), strict=True):
        if not lies_there:
            yield pdo


def why_not(device: EsiDevice) -> Iterator[str]:
    """What is assigned from the start and not begun with, in words; or that nothing is assigned."""
    for direction, pdos in (("outputs", device.outputs), ("inputs", device.inputs)):
        begun = begun_with(device, pdos)
        for pdo in pdos:
            if pdo.sync_manager is None or pdo in begun:
                continue
            if (other := _clash(pdo, begun)) is not None:
                why = f"it and 0x{other.index:04x} exclude each other"
            else:
                why = f"its sync manager {pdo.sync_manager} lies apart from that of 0x{begun[0].index:04x}"
                why += "; it is mandatory, so this terminal can't be used" if pdo.mandatory else ""
            yield f"PDO 0x{pdo.index:04x} {pdo.name}: left out, {why}"
        if pdos and all(pdo.sync_manager is None for pdo in pdos):
            listed = ", ".join(f"0x{pdo.index:04x}" for pdo in pdos)
            yield f"none of its {direction} is assigned from the start; it has the PDOs {listed}"


def _clash(pdo: EsiPdo, others: Sequence[EsiPdo]) -> EsiPdo | None:
    """The first of the others that can't be assigned together with a PDO."""
    return next((each for each in others if each.index in pdo.excludes or pdo.index in each.excludes), None)


def _start(device: EsiDevice, manager: int) -> int:
    """Where a sync manager begins; far from all others where the file does not say."""
    managers = device.sync_managers
    return managers[manager].start if manager < len(managers) else -(1 << 20) * (manager + 1)
