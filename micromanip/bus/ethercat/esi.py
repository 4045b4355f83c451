"""ESI files: what the maker of a terminal says of it, as XML (ETG.2000): identity, PDOs, sync managers, mailbox, clock.

Read are the elements below ``EtherCATInfo/Vendor`` and ``Descriptions/Devices/Device``; what else there is does no
harm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

from micromanip.errors import ConfigError

from .esi_document import EsiDocument, known_type, text_of

_ENGLISH = "1033"


@dataclass(frozen=True)
class EsiEntry:
    """An object in a PDO, index 0 for a gap; `line` is its line in the file.

    `type` is one that `field_type` knows also where the file names a type of its own that is based on it; `scale` is
    what the file says of its range, in the maker's words: "+/-10".
    """

    index: int
    subindex: int
    bits: int
    name: str
    type: str
    line: int
    scale: str = ""

    @property
    def mapping(self) -> int:
        """As a PDO's mapping holds it."""
        return self.index << 16 | self.subindex << 8 | self.bits


@dataclass(frozen=True)
class EsiPdo:
    """A PDO; `sync_manager` is the one that it is assigned to from the start, None where it is not."""

    index: int
    name: str
    entries: Sequence[EsiEntry]
    sync_manager: int | None
    fixed: bool
    mandatory: bool
    excludes: frozenset[int]
    line: int


@dataclass(frozen=True)
class EsiSyncManager:
    """A sync manager by default: what it is for, where its memory begins, its bytes, its control byte."""

    kind: str
    start: int
    bytes: int
    control: int


@dataclass(frozen=True)
class EsiDevice:
    """A kind of terminal; `outputs` are the PDOs that it receives (``RxPdo``), `inputs` those that it sends.

    `revision` is None where the file has none: it is about all of them. A terminal that `has_slots` has more PDOs:
    those of the modules in them.
    """

    vendor: int
    product: int
    revision: int | None
    name: str
    outputs: Sequence[EsiPdo]
    inputs: Sequence[EsiPdo]
    sync_managers: Sequence[EsiSyncManager]
    has_coe: bool
    maps: bool
    has_clock: bool
    has_slots: bool
    line: int


def read_esi(
    path: Path, product: int | None = None, left_out: Callable[[ConfigError], None] | None = None
) -> Sequence[EsiDevice]:
    """All devices of a file, or those with one product code, whatever the others are like; that may be none.

    Raises ConfigError with file and line, another MicromanipError if it can't be opened. `left_out` gets that of a
    single device instead: a maker's couplers may have no product code.
    """
    read = EsiDocument(path)
    vendor, found = _vendor_and_devices(read)
    devices = []
    for each in found:
        if product is None or _product(read, each) == product:
            try:
                devices.append(_device(read, vendor, each))
            except ConfigError as problem:
                if left_out is None:
                    raise
                left_out(problem)
    return devices


def _vendor_and_devices(read: EsiDocument) -> tuple[int, Sequence[Element]]:
    """The vendor's number, and the elements of the devices, of which there is one at least. Raises ConfigError."""
    root = read.root()
    if root.tag != "EtherCATInfo":
        raise read.error(read.lines[root], f"<{root.tag[:40]}> is no ESI file: that begins with <EtherCATInfo>")
    vendor = root.find("Vendor")
    if vendor is None:
        raise read.error(read.lines[root], "<EtherCATInfo> has no <Vendor>")
    number = read.child_number(vendor, "Id", 0xFFFF_FFFF)
    found = root.findall("Descriptions/Devices/Device")
    if not found:
        other = root.find("InfoReference")
        where = "" if other is None else f"; it refers to another file: {text_of(other)[:80]}"
        raise read.error(read.lines[root], f"there is no <Device> in <Descriptions> <Devices>{where}")
    return number, found


def esi_products(path: Path) -> Sequence[int]:
    """The product codes in a file, as far as it has them. Raises as `read_esi`."""
    read = EsiDocument(path)
    codes = (_product(read, each) for each in read.root().iterfind("Descriptions/Devices/Device"))
    return sorted({code for code in codes if code is not None})


def _product(read: EsiDocument, device: Element) -> int | None:
    """Its product code; None where it has none that can be read."""
    kind = device.find("Type")
    try:
        return None if kind is None else read.number(kind, kind.get("ProductCode"), "ProductCode", 0xFFFF_FFFF)
    except ConfigError:
        return None


def _device(read: EsiDocument, vendor: int, element: Element) -> EsiDevice:
    kind, coe = element.find("Type"), element.find("Mailbox/CoE")
    if kind is None:
        raise read.error(read.lines[element], "<Device> has no <Type>")
    if not (kind.get("ProductCode") or "").strip():
        name = _name(element) or text_of(kind)
        raise read.error(read.lines[kind], f"<Type> of {name[:60] or 'a device'} has no ProductCode")
    product = read.number(kind, kind.get("ProductCode"), "ProductCode", 0xFFFF_FFFF)
    revision = (kind.get("RevisionNo") or "").strip() or None
    own_types = {
        text_of(each.find("Name")): text_of(each.find("BaseType"))
        for each in element.iterfind("Profile/Dictionary/DataTypes/DataType")
    }
    managers = [
        EsiSyncManager(
            text_of(each),
            *(read.number(each, each.get(n), n, 0xFFFF, 0) for n in ("StartAddress", "DefaultSize", "ControlByte")),
        )
        for each in element.iterfind("Sm")
    ]
    return EsiDevice(
        vendor=vendor,
        product=product,
        revision=None if revision is None else read.number(kind, revision, "RevisionNo", 0xFFFF_FFFF),
        name=_name(element) or text_of(kind),
        outputs=[_pdo(read, pdo, own_types) for pdo in element.iterfind("RxPdo")],
        inputs=[_pdo(read, pdo, own_types) for pdo in element.iterfind("TxPdo")],
        sync_managers=managers,
        has_coe=coe is not None,
        maps=coe is not None and _is_true(coe.get("PdoConfig")),
        has_clock=element.find("Dc") is not None,
        has_slots=element.find("Slots") is not None,
        line=read.lines[element],
    )


def _pdo(read: EsiDocument, element: Element, own_types: Mapping[str, str]) -> EsiPdo:
    manager = (element.get("Sm") or "").strip()
    return EsiPdo(
        read.child_number(element, "Index", 0xFFFF),
        _name(element),
        list(_entries(read, element, own_types)),
        None if not manager else read.number(element, manager, "Sm", 0xFF),
        _is_true(element.get("Fixed")),
        _is_true(element.get("Mandatory")),
        frozenset(read.number(each, each.text, "Exclude", 0xFFFF) for each in element.iterfind("Exclude")),
        read.lines[element],
    )


def _entries(read: EsiDocument, pdo: Element, own_types: Mapping[str, str]) -> Iterator[EsiEntry]:
    for element in pdo.iterfind("Entry"):
        kind = element.find("DataType")
        yield EsiEntry(
            read.child_number(element, "Index", 0xFFFF),
            read.child_number(element, "SubIndex", 0xFF, 0),
            read.child_number(element, "BitLen", 0xFFFF),
            _name(element),
            known_type(text_of(kind), own_types),
            read.lines[element],
            "" if kind is None else " ".join((kind.get("DScale") or "").split()),
        )


def _name(element: Element) -> str:
    """The English one of its names, or the first."""
    names = element.findall("Name")
    return text_of(
        next((each for each in names if each.get("LcId", "").strip() == _ENGLISH), names[0] if names else None)
    )


def _is_true(text: str | None) -> bool:
    return (text or "").strip().lower() in ("1", "true")
