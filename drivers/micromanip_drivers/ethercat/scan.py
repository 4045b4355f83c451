"""Who is on the line: counted, addressed, and asked by their EEPROMs; compared with the configuration."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from micromanip.driver import IdentityMismatch, LinkError
from micromanip.driver.ethercat import ERROR, INIT, in_first_area, registers

from .link import Link
from .options import Terminal

FIRST_STATION = 0x1001
_BUSY_S = 0.2
_VENDOR_WORD, _REVISION_WORD, _MAILBOX_WORD, _PROTOCOLS_WORD = 0x08, 0x0C, 0x18, 0x1C
_COE = 0x04
_CATEGORIES_WORD, _MOST_WORDS, _SYNC_MANAGERS, _INPUT_PDOS, _OUTPUT_PDOS, _END = 0x40, 0x1000, 41, 50, 51, 0xFFFF
_OUTPUTS, _INPUTS = 3, 4
"""Kinds of sync managers: process data from and to the master."""
_NOT_ASSIGNED = 0xFF


@dataclass(frozen=True)
class Area:
    """Process data of one direction in a slave's memory: the sync manager, its start and its control byte.

    The one of outputs feeds the watchdog, whatever else the EEPROM says.
    """

    manager: int
    start: int
    control: int


Pdos = Sequence[tuple[int, Sequence[int]]]
"""Index of each PDO, with the entries that it maps (index << 16 | subindex << 8 | bits)."""
_USUAL = Area(2, 0x1100, 0x64), Area(3, 0x1180, 0x20)
"""Unless the EEPROM lists sync managers: those of outputs and of inputs."""


@dataclass(frozen=True)
class Slave:
    """What the EEPROM of the slave at a station says; mailboxes are (start, bytes), None where there is no CoE.

    Its process data lie in the areas `outputs` and `inputs`; the PDOs are those that the EEPROM has assigned there.
    """

    station: int
    vendor: int
    product: int
    revision: int
    serial: int
    mailbox_out: tuple[int, int] | None
    mailbox_in: tuple[int, int] | None
    outputs: Area = _USUAL[0]
    inputs: Area = _USUAL[1]
    output_pdos: Pdos = ()
    input_pdos: Pdos = ()

    @property
    def identity(self) -> Mapping[str, int]:
        """By the keys of the configuration."""
        return {"vendor": self.vendor, "product": self.product, "revision": self.revision, "serial": self.serial}


def count(link: Link) -> int:
    """How many slaves there are. Raises LinkError where no frame comes back."""
    return link.read(registers.BRD, 0, registers.ESC_TYPE, 1).wkc


def reset(link: Link) -> None:
    """All slaves to INIT, errors acknowledged, nothing mapped, no SYNC signal left on by whoever was master before."""
    broadcast = registers.BWR
    link.write(broadcast, 0, registers.AL_CONTROL, struct.pack("<H", INIT | ERROR))
    link.write(broadcast, 0, registers.FMMU, bytes(8 * registers.FMMU_BYTES))
    link.write(broadcast, 0, registers.SM, bytes(4 * registers.SM_BYTES))
    link.write(broadcast, 0, registers.DC_ACTIVATE, b"\0")
    link.write(broadcast, 0, registers.SII_CONFIG, b"\x02")  # the EEPROM to the master, also from a slave that held it
    link.write(broadcast, 0, registers.SII_CONFIG, b"\x00")


def found(link: Link) -> Iterator[Slave]:
    """Each slave in its order, with a station address from now on. Raises LinkError.

    Their order is known by a whole ring only: from its far end it is another one.
    """
    slaves = count(link)
    if link.open_behind is not None:
        where = f"behind slave {link.open_behind}" if link.open_behind else "in front of the first slave"
        raise LinkError(
            f"{link.name}: the ring is open {where}, {slaves} slaves answer: it is brought up whole only; "
            "check cables and power, or say return_interface: null for a line"
        )
    for k in range(slaves):
        station = FIRST_STATION + k
        link.write(registers.APWR, -k, registers.STATION, struct.pack("<H", station))
        yield _asked(link, station)


def require(link: Link, terminals: Mapping[str, Terminal]) -> Sequence[Slave]:
    """The slaves, which must be those of the configuration in its order. Raises LinkError, IdentityMismatch."""
    slaves = list(found(link))
    if len(slaves) != len(terminals):
        raise LinkError(
            f"{link.name}: {len(slaves)} slaves answer, but {len(terminals)} terminals are configured; "
            f"found {_listed(slaves)}; check power and cables, or list what is there"
        )
    for place, (slave, (name, terminal)) in enumerate(zip(slaves, terminals.items(), strict=True), 1):
        if wrong := differences(slave, terminal):
            others = [other for other, t in terminals.items() if not differences(slave, t)]
            hint = f"; it is {others[0]} by its identity: the order has changed" if others else ""
            raise IdentityMismatch(f"{link.name}: slave {place}, terminal {name}, has {' and '.join(wrong)}{hint}")
    return slaves


def differences(slave: Slave, terminal: Terminal) -> Sequence[str]:
    """What of its identity is not as configured, in words."""
    return [
        f"{key} 0x{value:x} instead of 0x{wanted:x}"
        for key, value in slave.identity.items()
        if (wanted := getattr(terminal, key)) not in (None, value)
    ]


def _asked(link: Link, station: int) -> Slave:
    vendor, product = struct.unpack("<II", sii(link, station, _VENDOR_WORD))
    revision, serial = struct.unpack("<II", sii(link, station, _REVISION_WORD))
    out_at, out_bytes, in_at, in_bytes = struct.unpack("<4H", sii(link, station, _MAILBOX_WORD))
    (protocols,) = struct.unpack_from("<H", sii(link, station, _PROTOCOLS_WORD))
    has_coe = bool(protocols & _COE and out_bytes and in_bytes)
    return Slave(
        *(station, vendor, product, revision, serial),
        (out_at, out_bytes) if has_coe else None,
        (in_at, in_bytes) if has_coe else None,
        *_process_data(link, station, has_coe),
    )


def _process_data(link: Link, station: int, has_coe: bool) -> tuple[Area, Area, Pdos, Pdos]:
    """Areas and PDOs of outputs and inputs, by the EEPROM; PDOs only where no mailbox tells of them."""
    managers: Mapping[int, Area] = {}
    starts: Sequence[int] = ()
    pdos: dict[int, Sequence[tuple[int, int, Sequence[int]]]] = {}
    word = _CATEGORIES_WORD
    while word < _MOST_WORDS:
        kind, length = struct.unpack_from("<HH", sii(link, station, word))
        if kind == _END:
            break
        if kind == _SYNC_MANAGERS or (kind in (_INPUT_PDOS, _OUTPUT_PDOS) and not has_coe):
            content = b"".join(sii(link, station, word + 2 + at) for at in range(0, length, 4))[: 2 * length]
            if kind == _SYNC_MANAGERS:
                managers = dict(_areas(content))
                starts = [struct.unpack_from("<H", content, at)[0] for at in range(0, len(content) - 7, 8)]
            else:
                pdos[kind] = list(_assigned(content))
        word += 2 + length
    outputs, inputs = managers.get(_OUTPUTS, _USUAL[0]), managers.get(_INPUTS, _USUAL[1])
    output_pdos, input_pdos = (in_one_area(pdos.get(kind, ()), starts) for kind in (_OUTPUT_PDOS, _INPUT_PDOS))
    return outputs, inputs, output_pdos, input_pdos


def _areas(content: bytes) -> Iterator[tuple[int, Area]]:
    """The first area of each kind. Older EEPROMs leave the kind out: then the control byte tells."""
    seen = set()
    for k in range(len(content) // 8):
        start, _, control, _, _, kind = struct.unpack_from("<HHBBBB", content, 8 * k)
        is_written = control & registers.SM_FROM_MASTER
        if kind == 0 and start and not control & registers.SM_MAILBOX:
            kind = _OUTPUTS if is_written else _INPUTS
        if kind in (_OUTPUTS, _INPUTS) and kind not in seen:
            seen.add(kind)
            yield kind, Area(k, start, control | (registers.SM_WATCHDOG if kind == _OUTPUTS else 0))


def _assigned(content: bytes) -> Iterator[tuple[int, int, Sequence[int]]]:
    """The PDOs of a category that a sync manager has from the start: that, index and entries."""
    at = 0
    while at + 8 <= len(content):
        index, count, manager = struct.unpack_from("<HBB", content, at)
        at += 8
        entries = list(struct.iter_unpack("<HBxxBxx", content[at : at + 8 * count].ljust(8 * count, b"\0")))
        at += 8 * count
        if manager != _NOT_ASSIGNED:
            yield manager, index, [entry << 16 | subindex << 8 | bits for entry, subindex, bits in entries]


def in_one_area(pdos: Sequence[tuple[int, int, Sequence[int]]], starts: Sequence[int]) -> Pdos:
    """Those of a direction that are exchanged, of (sync manager, index, entries): others begin elsewhere.

    `starts` are the addresses of the sync managers; none, or not enough, in older EEPROMs: then they are one area.
    """

    def begins_after(manager: int, before: int, bits: int) -> bool:
        is_known = max(manager, before) < len(starts)
        return not is_known or (bits % 8 == 0 and starts[manager] == starts[before] + bits // 8)

    sizes = ((manager, sum(entry & 0xFF for entry in entries)) for manager, _, entries in pdos)
    lie_there = in_first_area(sizes, begins_after)
    return [(index, entries) for (_, index, entries), is_one in zip(pdos, lie_there, strict=True) if is_one]


def sii(link: Link, station: int, word: int) -> bytes:
    """8 bytes of a slave's EEPROM. Raises LinkError."""
    link.station_write(station, registers.SII_ADDRESS, struct.pack("<I", word))
    data = b""
    while len(data) < 8:
        step = word + len(data) // 2
        request = struct.pack("<HI", registers.SII_READ, step)
        link.station_write(station, registers.SII_CONTROL, request)
        end = time.monotonic() + _BUSY_S
        while True:
            status, _, found_now = struct.unpack("<HI8s", link.station_read(station, registers.SII_CONTROL, 14))
            if not status & registers.SII_BUSY:
                break
            if time.monotonic() > end:
                raise LinkError(f"{link.name}: the EEPROM of station 0x{station:04x} stays busy")
        data += found_now[: 8 if status & registers.SII_READS_8 else 4]
    return data[:8]


def _listed(slaves: Sequence[Slave]) -> str:
    return ", ".join(f"0x{slave.vendor:x}:0x{slave.product:x}" for slave in slaves) or "none"
