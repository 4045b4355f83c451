"""Who is on the line: counted, addressed, and asked by their EEPROMs; compared with the configuration."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from micromanip.driver import IdentityMismatch, LinkError
from micromanip.driver.ethercat import ERROR, INIT, registers

from .link import Link
from .options import Terminal

FIRST_STATION = 0x1001
_BUSY_S = 0.2
_VENDOR_WORD, _REVISION_WORD, _MAILBOX_WORD, _PROTOCOLS_WORD = 0x08, 0x0C, 0x18, 0x1C
_COE = 0x04
_CATEGORIES_WORD, _MOST_WORDS, _SYNC_MANAGERS, _END = 0x40, 0x1000, 41, 0xFFFF
OUTPUTS_AT, INPUTS_AT = 0x1100, 0x1180
"""Where process data lie unless the EEPROM says otherwise."""


@dataclass(frozen=True)
class Slave:
    """What the EEPROM of the slave at a station says; mailboxes are (start, bytes), None where there is no CoE.

    `outputs_at` and `inputs_at` are where its process data lie.
    """

    station: int
    vendor: int
    product: int
    revision: int
    serial: int
    mailbox_out: tuple[int, int] | None
    mailbox_in: tuple[int, int] | None
    outputs_at: int
    inputs_at: int

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
        *_process_data_at(link, station),
    )


def _process_data_at(link: Link, station: int) -> tuple[int, int]:
    """Start of sync managers 2 and 3, by the category of the EEPROM that lists them."""
    word = _CATEGORIES_WORD
    while word < _MOST_WORDS:
        kind, length = struct.unpack_from("<HH", sii(link, station, word))
        if kind == _END:
            break
        if kind == _SYNC_MANAGERS and length >= 16:
            outputs, inputs = (sii(link, station, word + 2 + 4 * k) for k in (2, 3))
            return struct.unpack_from("<H", outputs)[0], struct.unpack_from("<H", inputs)[0]
        word += 2 + length
    return OUTPUTS_AT, INPUTS_AT


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
