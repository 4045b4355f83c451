"""A terminal of the configuration beside its ESI file: what does not agree, at its key, with the line of the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from micromanip.driver import ConfigError
from micromanip.driver.ethercat import EsiDevice, EsiEntry, EsiPdo, apart, esi_products, field_type, read_esi

from .options import InputPdo, OutputPdo, Terminal


def compare_with_file(name: str, terminal: Terminal, folder: Path) -> None:
    """Raises ConfigError with the first thing in which a terminal and its file, seen from `folder`, differ."""
    if terminal.esi is None:
        return
    path = folder / terminal.esi
    key = f"terminals.{name}"
    try:
        devices = read_esi(path, terminal.product)
        products = esi_products(path) if not devices else ()
    except ConfigError as problem:
        raise ConfigError(f"{key}.esi: {problem}") from problem
    device = _device(key, terminal, devices, products, path)
    for where, what, line in differences(terminal, device):
        raise ConfigError(f"{key}.{where}: {what} ({path}:{line})")


def differences(terminal: Terminal, device: EsiDevice) -> Iterator[tuple[str, str, int]]:
    """Key below the terminal's, what is wrong there, and the line of the file that says so."""
    if terminal.settings and not device.has_coe:
        yield "settings", "the terminal has no CoE mailbox that they could be written by", device.line
    if terminal.sync0_shift_us is not None and not device.has_clock:
        yield "sync0_shift_us", "the terminal has no distributed clock", device.line
    for direction, pdos, there in (
        ("outputs", terminal.outputs, device.outputs),
        ("inputs", terminal.inputs, device.inputs),
    ):
        yield from _of_direction(direction, pdos, there, device)


def _of_direction(
    direction: str, pdos: Mapping[str, OutputPdo | InputPdo], there: Sequence[EsiPdo], device: EsiDevice
) -> Iterator[tuple[str, str, int]]:
    by_index = {pdo.index: pdo for pdo in there}
    known = [(name, pdo, by_index[pdo.pdo]) for name, pdo in pdos.items() if pdo.pdo in by_index]
    for name, pdo in pdos.items():
        if pdo.pdo not in by_index:
            listed = ", ".join(f"0x{index:04x}" for index in by_index) or "none"
            modules = (
                "; it has slots, and PDOs of their modules are not read: leave esi out" if device.has_slots else ""
            )
            what = f"there is no PDO 0x{pdo.pdo:04x} among its {direction}: {listed}{modules}"
            yield f"{direction}.{name}.pdo", what, device.line
    taken = {found.index for _, _, found in known}
    for name, pdo, found in known:
        if clash := found.excludes & taken - {found.index}:
            yield f"{direction}.{name}.pdo", f"it excludes 0x{min(clash):04x}, which is assigned as well", found.line
        yield from ((f"{direction}.{name}.{key}", what, line) for key, what, line in _of_pdo(pdo, found, device))
    outside = [found.index for found in apart(device, [found for _, _, found in known])]
    for name, _, found in known:
        if found.index in outside:
            what = f"sync manager {found.sync_manager} lies apart from that of the others: one area is exchanged"
            yield f"{direction}.{name}.pdo", what, found.line
    for each in there:
        if each.mandatory and each.index not in taken and pdos:
            yield direction, f"PDO 0x{each.index:04x}, {each.name}, is mandatory and missing", each.line


def _of_pdo(pdo: Any, found: EsiPdo, device: EsiDevice) -> Iterator[tuple[str, str, int]]:
    is_free = device.maps and not found.fixed
    entries = {(entry.index, entry.subindex): entry for entry in found.entries if entry.index}
    for place, (name, field) in enumerate(pdo.fields.items()):
        there = entries.get((field.index, field.subindex))
        if not is_free:
            if place >= len(found.entries):
                count = len(found.entries)
                yield f"fields.{name}", f"PDO 0x{found.index:04x} is fixed and ends after {count} entries", found.line
                return
            there = found.entries[place]
            if there.mapping != field.mapping:
                yield f"fields.{name}", f"{_words(field)}, but entry {place + 1} is {_entry_words(there)}", there.line
                return
        ours = field_type(there.type, there.bits) if there is not None else None
        if there is not None and ours is not None and ours != field.type:
            yield f"fields.{name}.type", f"{field.type}, but the terminal has {there.type}, which is {ours}", there.line
    if not is_free and len(found.entries) > len(pdo.fields):
        missing = found.entries[len(pdo.fields)]
        yield "fields", f"PDO 0x{found.index:04x} is fixed; missing behind is {_entry_words(missing)}", missing.line


def _words(field: Any) -> str:
    return f"0x{field.index:04x}:{field.subindex:02x} of {field.bits} bits"


def _entry_words(entry: EsiEntry) -> str:
    return f"0x{entry.index:04x}:{entry.subindex:02x} of {entry.bits} bits, {entry.name or 'a gap'} ({entry.type})"


def _device(
    key: str, terminal: Terminal, devices: Sequence[EsiDevice], products: Sequence[int], path: Path
) -> EsiDevice:
    """That of the file which the terminal is; of several revisions its own, or the newest where any will do.

    `devices` are those of its product, `products` those that the file has where there is none.
    """
    if not devices:
        listed = ", ".join(f"0x{each:x}" for each in products[:8]) or "none"
        raise ConfigError(f"{key}.product: there is no device 0x{terminal.product:x} in {path}; it has {listed}")
    if devices[0].vendor != terminal.vendor:
        raise ConfigError(f"{key}.vendor: 0x{terminal.vendor:x}, but {path} is of 0x{devices[0].vendor:x}")
    found = [
        each for each in devices if None in (terminal.revision, each.revision) or terminal.revision == each.revision
    ]
    if not found:
        listed = ", ".join(f"0x{each.revision:x}" for each in devices)
        raise ConfigError(
            f"{key}.revision: 0x{terminal.revision:x}, but the file has {listed} ({path}:{devices[0].line})"
        )
    return max(found, key=lambda each: -1 if each.revision is None else each.revision)
