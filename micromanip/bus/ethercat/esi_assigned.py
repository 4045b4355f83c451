"""Which PDOs of an ESI device a configuration begins with: of those assigned from the start the ones of use."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .esi import EsiDevice, EsiPdo
from .process_data import in_first_area


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
