"""ESI files: what the maker of a terminal says of it, as XML (ETG.2000): identity, PDOs, sync managers, mailbox, clock.

Read are the elements below ``EtherCATInfo/Vendor`` and ``Descriptions/Devices/Device``; what else there is does no
harm. A document type, and with it any entity of the file's own, is refused: such a file may be small, its text endless.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from micromanip.bus.number_options import PACKED
from micromanip.errors import ConfigError, system_error
from micromanip.files.regular_file import open_regular

MOST_BYTES = 64 * 1024 * 1024
_MOST_DEEP = 100
_ENGLISH = "1033"
TYPES = {
    "SINT": "int8", "USINT": "uint8", "BYTE": "uint8", "BITARR8": "uint8", "BIT8": "uint8",
    "INT": "int16", "UINT": "uint16", "WORD": "uint16", "BITARR16": "uint16", "BIT16": "uint16",
    "INT24": "int24", "UINT24": "uint24",
    "DINT": "int32", "UDINT": "uint32", "DWORD": "uint32", "BITARR32": "uint32", "REAL": "float32",
    "LINT": "int64", "ULINT": "uint64", "LWORD": "uint64", "LREAL": "float64",
    "BOOL": "bool", "BIT": "bool", "BIT1": "bool",
    **{kind.upper(): kind for kind in PACKED if kind != "bool"},
}  # fmt: skip
"""Types of the files by ours; there are others, of texts."""


@dataclass(frozen=True)
class EsiEntry:
    """An object in a PDO, index 0 for a gap; `line` is its line in the file.

    `type` is one of `TYPES` also where the file names a type of its own that is one of them.
    """

    index: int
    subindex: int
    bits: int
    name: str
    type: str
    line: int

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


@dataclass
class _Read:
    """A file as it is read: elements, and the line of each."""

    path: Path
    builder: TreeBuilder = field(default_factory=TreeBuilder)
    lines: dict[Element, int] = field(default_factory=dict)
    deep: int = 0

    def error(self, line: int, what: str) -> ConfigError:
        return ConfigError(f"{self.path}:{line}: {what}")

    def document(self) -> Element:
        """Its root. Raises ConfigError."""
        try:
            with open_regular(self.path, MOST_BYTES) as opened:
                text = opened.read()
        except OSError as problem:
            raise system_error(problem, self.path) from problem
        parser = expat.ParserCreate()
        parser.buffer_text = True

        def start(name: str, attributes: dict[str, str]) -> None:
            self.deep += 1
            if self.deep > _MOST_DEEP:
                raise self.error(parser.CurrentLineNumber, f"elements lie in each other more than {_MOST_DEEP} deep")
            self.lines[self.builder.start(_local(name), attributes)] = parser.CurrentLineNumber

        def end(name: str) -> None:
            self.deep -= 1
            self.builder.end(_local(name))

        def refuse(*_: object) -> None:
            raise self.error(parser.CurrentLineNumber, "a document type (<!DOCTYPE) is refused: ESI files have none")

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = self.builder.data, refuse
        try:
            parser.Parse(text, True)
        except expat.ExpatError as problem:
            raise self.error(problem.lineno, f"this is no XML: {expat.ErrorString(problem.code)}") from problem
        except (ValueError, LookupError) as problem:  # of an encoding that nobody knows, or that is none for texts
            raise self.error(parser.CurrentLineNumber, f"its text can't be read: {problem}") from problem
        return self.builder.close()

    def number(self, element: Element, text: str | None, what: str, most: int, default: int | None = None) -> int:
        """A number as ESI files have it, ``#x1a00`` or decimal. Raises ConfigError."""
        said = (text or "").strip()
        if not said and default is not None:
            return default
        hexadecimal = said[:2].lower() == "#x"
        digits = said[2:] if hexadecimal else said
        if digits.isascii() and digits.isalnum() and len(digits) <= 20:  # 1_0, +1 and other scripts are none
            try:
                number = int(digits, 16 if hexadecimal else 10)
            except ValueError:
                number = -1
            if 0 <= number <= most:
                return number
        line = self.lines[element]
        raise self.error(line, f"{what} {said[:40]!r} is no number from 0 to {most} (#x1a00, or decimal)")

    def child_number(self, parent: Element, name: str, most: int, default: int | None = None) -> int:
        found = parent.find(name)
        if found is None and default is None:
            raise self.error(self.lines[parent], f"<{parent.tag}> has no <{name}>")
        return self.number(parent if found is None else found, _text(found), name, most, default)


def read_esi(path: Path, product: int | None = None) -> Sequence[EsiDevice]:
    """All devices of a file, or those with one product code, whatever the others are like; that may be none.

    Raises ConfigError with file and line, another MicromanipError if it can't be opened.
    """
    read = _Read(path)
    vendor, found = _vendor_and_devices(read)
    return [_device(read, vendor, each) for each in found if product is None or _product(read, each) == product]


def esi_listing(path: Path) -> Sequence[EsiDevice | ConfigError]:
    """Each device of a file, or in its place why it can't be read: a maker's couplers may have no product code.

    Raises as `read_esi` where that is so for the file as a whole.
    """
    read = _Read(path)
    vendor, found = _vendor_and_devices(read)

    def listed(element: Element) -> EsiDevice | ConfigError:
        try:
            return _device(read, vendor, element)
        except ConfigError as problem:
            return problem

    return [listed(each) for each in found]


def _vendor_and_devices(read: _Read) -> tuple[int, Sequence[Element]]:
    """The vendor's number, and the elements of the devices, of which there is one at least. Raises ConfigError."""
    root = read.document()
    if root.tag != "EtherCATInfo":
        raise read.error(read.lines[root], f"<{root.tag[:40]}> is no ESI file: that begins with <EtherCATInfo>")
    vendor = root.find("Vendor")
    if vendor is None:
        raise read.error(read.lines[root], "<EtherCATInfo> has no <Vendor>")
    number = read.child_number(vendor, "Id", 0xFFFF_FFFF)
    found = root.findall("Descriptions/Devices/Device")
    if not found:
        other = root.find("InfoReference")
        where = "" if other is None else f"; it refers to another file: {_text(other)[:80]}"
        raise read.error(read.lines[root], f"there is no <Device> in <Descriptions> <Devices>{where}")
    return number, found


def esi_products(path: Path) -> Sequence[int]:
    """The product codes in a file, as far as it has them. Raises as `read_esi`."""
    read = _Read(path)
    codes = (_product(read, each) for each in read.document().iterfind("Descriptions/Devices/Device"))
    return sorted({code for code in codes if code is not None})


def _product(read: _Read, device: Element) -> int | None:
    """Its product code; None where it has none that can be read."""
    kind = device.find("Type")
    try:
        return None if kind is None else read.number(kind, kind.get("ProductCode"), "ProductCode", 0xFFFF_FFFF)
    except ConfigError:
        return None


def _device(read: _Read, vendor: int, element: Element) -> EsiDevice:
    kind, coe = element.find("Type"), element.find("Mailbox/CoE")
    if kind is None:
        raise read.error(read.lines[element], "<Device> has no <Type>")
    if not (kind.get("ProductCode") or "").strip():
        name = _name(element) or _text(kind)
        raise read.error(read.lines[kind], f"<Type> of {name[:60] or 'a device'} has no ProductCode")
    product = read.number(kind, kind.get("ProductCode"), "ProductCode", 0xFFFF_FFFF)
    revision = (kind.get("RevisionNo") or "").strip() or None
    own_types = {
        _text(each.find("Name")): _text(each.find("BaseType"))
        for each in element.iterfind("Profile/Dictionary/DataTypes/DataType")
    }
    managers = [
        EsiSyncManager(
            _text(each),
            *(read.number(each, each.get(n), n, 0xFFFF, 0) for n in ("StartAddress", "DefaultSize", "ControlByte")),
        )
        for each in element.iterfind("Sm")
    ]
    return EsiDevice(
        vendor=vendor,
        product=product,
        revision=None if revision is None else read.number(kind, revision, "RevisionNo", 0xFFFF_FFFF),
        name=_name(element) or _text(kind),
        outputs=[_pdo(read, pdo, own_types) for pdo in element.iterfind("RxPdo")],
        inputs=[_pdo(read, pdo, own_types) for pdo in element.iterfind("TxPdo")],
        sync_managers=managers,
        has_coe=coe is not None,
        maps=coe is not None and _is_true(coe.get("PdoConfig")),
        has_clock=element.find("Dc") is not None,
        has_slots=element.find("Slots") is not None,
        line=read.lines[element],
    )


def _pdo(read: _Read, element: Element, own_types: Mapping[str, str]) -> EsiPdo:
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


def _entries(read: _Read, pdo: Element, own_types: Mapping[str, str]) -> Iterator[EsiEntry]:
    for element in pdo.iterfind("Entry"):
        yield EsiEntry(
            read.child_number(element, "Index", 0xFFFF),
            read.child_number(element, "SubIndex", 0xFF, 0),
            read.child_number(element, "BitLen", 0xFFFF),
            _name(element),
            _type(_text(element.find("DataType")), own_types),
            read.lines[element],
        )


def _type(said: str, own_types: Mapping[str, str]) -> str:
    """That which a type of the file's own is based on, if it is one."""
    known = (each for each in (said, own_types.get(said, "")) if each.upper() in TYPES)
    return next((each.upper() for each in known), said)


def _name(element: Element) -> str:
    """The English one of its names, or the first."""
    names = element.findall("Name")
    return _text(
        next((each for each in names if each.get("LcId", "").strip() == _ENGLISH), names[0] if names else None)
    )


def _local(name: str) -> str:
    """A tag without the prefix of its namespace."""
    return name.rpartition(":")[2]


def _text(element: Element | None) -> str:
    """In one line."""
    return "" if element is None else " ".join((element.text or "").split())


def _is_true(text: str | None) -> bool:
    return (text or "").strip().lower() in ("1", "true")
