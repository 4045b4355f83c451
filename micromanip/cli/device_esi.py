"""``micromanip device esi``: what the ESI file of an EtherCAT terminal says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .echo import echo
from .options import Answer, subcommand

if TYPE_CHECKING:
    from micromanip.bus.ethercat.esi import EsiDevice


class _Code(click.ParamType):  # type: ignore[type-arg]  # generic in newer versions of click only
    name = "code"

    def __init__(self, what: str) -> None:
        self._what = what

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        try:
            code = int(value, 0)
        except ValueError:
            code = -1
        if not 0 <= code <= 0xFFFF_FFFF:
            self.fail(f"{value!r:.40} is no {self._what}; they look like 0x1003 or 4099.", param, ctx)
        return code


@subcommand("esi", "micromanip device esi config/ethercat/piezo-cell.xml --product 0x1003")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@click.option("--product", type=_Code("product code"), help="Only this one, by its code: 0x1003.")
@click.option("--revision", type=_Code("revision"), help="Only this one of its revisions: 0x110000.")
def esi(file: Path, product: int | None, revision: int | None) -> Answer:
    """List the devices of an ESI FILE (EtherCAT); of a single one, its keys below `terminals` of a configuration.

    These are the PDOs that it has assigned from the start. Scales and ranges stand in its manual.
    """
    from micromanip.errors import UsageError

    devices = _all(file) if product is None else _of_product(file, product)
    if revision is not None:
        there = ", ".join(sorted({_revision(each) for each in devices}))
        devices = [each for each in devices if each.revision == revision]
        if not devices:
            raise UsageError(f"{file} has no device with the revision 0x{revision:x}; it has {there}")
    return Answer([_document(each) for each in devices], lambda: _show(devices))


def _all(file: Path) -> Sequence[EsiDevice]:
    """Those of a file that can be read; what is wrong with each other one is told."""
    from micromanip.bus.ethercat.esi import read_esi

    problems: list[Exception] = []
    devices = read_esi(file, left_out=problems.append)
    if not devices:
        raise problems[0]
    for problem in problems:
        echo(f"left out: {problem}", err=True)
    return devices


def _of_product(file: Path, product: int) -> Sequence[EsiDevice]:
    from micromanip.bus.ethercat.esi import read_esi
    from micromanip.errors import UsageError

    devices = read_esi(file, product)
    if not devices:
        raise UsageError(f"{file} has no device with the product code 0x{product:x}; without --product all are listed")
    return devices


def _revision(device: EsiDevice) -> str:
    return "any" if device.revision is None else f"0x{device.revision:x}"


def _document(device: EsiDevice) -> dict[str, Any]:
    from micromanip.bus.ethercat.esi_keys import not_mapped, remarks, terminal_keys

    name, keys = terminal_keys(device, set())
    return {
        "name": device.name,
        "line": device.line,
        "sync_managers": [vars(each) for each in device.sync_managers],
        "coe": device.has_coe,
        "pdos_may_be_mapped": device.maps,
        "clock": device.has_clock,
        "slots": device.has_slots,
        "terminal": {name: keys},
        "not_mapped": [
            {"pdo": pdo.index, "index": entry.index, "subindex": entry.subindex, "bits": entry.bits, "type": entry.type}
            for pdo, entry in not_mapped(device)
        ],
        "remarks": list(remarks(device)),
    }


def _show(devices: Sequence[EsiDevice]) -> None:
    from micromanip.bus.ethercat.esi_keys import lines_of, remarks, terminal_keys

    from .tables import print_table

    if len(devices) > 1:
        rows = (
            (
                f"0x{each.product:x}", _revision(each), each.name, str(len(each.outputs)), str(len(each.inputs)),
                "yes" if each.has_clock else "no",
            )
            for each in devices
        )  # fmt: skip
        print_table(("product", "revision", "name", "outputs", "inputs", "clock"), rows)
        return
    (device,) = devices
    click.echo("\n".join(lines_of(*terminal_keys(device, set()))))
    for remark in remarks(device):
        echo(f"# {remark}")
