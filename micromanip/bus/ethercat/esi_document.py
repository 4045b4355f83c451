"""An ESI file as XML, each element with its line, its numbers, and its types by ours.

A document type, and with it any entity of the file's own, is refused: such a file may be small, its text endless.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from micromanip.bus.number_options import BITS, PACKED
from micromanip.errors import ConfigError, system_error
from micromanip.files import marked_encoding, open_regular

MOST_BYTES = 64 * 1024 * 1024
_MOST_DEEP = 100
_HEXADECIMAL = re.compile(r"(?:#x0x|#x|0x)([0-9a-f]{1,20})", re.IGNORECASE)
"""``#x1a00`` by ETG.2000; makers write the others as well."""
_DECIMAL = re.compile(r"[0-9]{1,20}", re.ASCII)  # 1_0, +1 and other scripts are none

_DECLARED = re.compile(rb"""\s*<\?xml\s[^>]*?encoding\s*=\s*["']([A-Za-z][\w.-]*)["']""")
_WIDER = {"utf-8": "cp1252", "gb2312": "gb18030", "gbk": "gb18030", "shift_jis": "cp932", "euc_kr": "cp949"}
"""What is meant where a file has letters that the encoding which it declares has not."""


@dataclass
class EsiDocument:
    """A file as it is read: elements, and the line of each."""

    path: Path
    builder: TreeBuilder = field(default_factory=TreeBuilder)
    lines: dict[Element, int] = field(default_factory=dict)
    deep: int = 0

    def error(self, line: int, what: str) -> ConfigError:
        return ConfigError(f"{self.path}:{line}: {what}")

    def root(self) -> Element:
        """Of all elements, tags without the prefixes of namespaces. Raises ConfigError."""
        try:
            with open_regular(self.path, MOST_BYTES) as opened:
                content = opened.read()
        except OSError as problem:
            raise system_error(problem, self.path) from problem
        parser = expat.ParserCreate("utf-8")
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
            parser.Parse(_text(content).encode(), True)  # expat itself knows few encodings
        except expat.ExpatError as problem:
            raise self.error(problem.lineno, f"this is no XML: {expat.ErrorString(problem.code)}") from problem
        except (ValueError, LookupError) as problem:  # of an encoding that nobody knows, or that is none for texts
            raise self.error(parser.CurrentLineNumber, f"its text can't be read: {problem}") from problem
        return self.builder.close()

    def number(self, element: Element, said: str | None, what: str, most: int, default: int | None = None) -> int:
        """A number as ESI files have it, ``#x1a00`` or decimal. Raises ConfigError."""
        digits = (said or "").strip()
        if not digits and default is not None:
            return default
        number = -1
        if found := _HEXADECIMAL.fullmatch(digits):
            number = int(found[1], 16)
        elif _DECIMAL.fullmatch(digits):
            number = int(digits)
        if 0 <= number <= most:
            return number
        line = self.lines[element]
        raise self.error(line, f"{what} {digits[:40]!r} is no number from 0 to {most} (#x1a00, or decimal)")

    def child_number(self, parent: Element, name: str, most: int, default: int | None = None) -> int:
        """The number in a child of that name; `default` where there is none. Raises ConfigError."""
        found = parent.find(name)
        if found is None and default is None:
            raise self.error(self.lines[parent], f"<{parent.tag}> has no <{name}>")
        return self.number(parent if found is None else found, text_of(found), name, most, default)


def text_of(element: Element | None) -> str:
    """In one line."""
    return "" if element is None else " ".join((element.text or "").split())


def _text(content: bytes) -> str:
    """By its mark, or as it declares; by a wider page where that has not its letters. Raises LookupError."""
    declared = _DECLARED.match(content[:1000])
    encoding = marked_encoding(content) or (declared[1].decode() if declared else "utf-8")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError:
        return content.decode(_WIDER.get(codecs.lookup(encoding).name, encoding), "replace")


def _local(name: str) -> str:
    """A tag without the prefix of its namespace."""
    return name.rpartition(":")[2]


_OURS = {
    "SINT": "int8", "USINT": "uint8", "BYTE": "uint8", "BITARR8": "uint8", "BIT8": "uint8",
    "INT": "int16", "UINT": "uint16", "WORD": "uint16", "BITARR16": "uint16", "BIT16": "uint16",
    "DINT": "int32", "UDINT": "uint32", "DWORD": "uint32", "BITARR32": "uint32", "REAL": "float32",
    "LINT": "int64", "ULINT": "uint64", "LWORD": "uint64", "LREAL": "float64",
    "BOOL": "bool", "BIT": "bool", "BIT1": "bool",
    **{kind.upper(): kind for kind in BITS},
}  # fmt: skip
"""By ETG.1020, and UINT16 and the like, as some makers write them; there are others, of texts."""
_UNSIGNED = {bits: kind for kind, bits in BITS.items() if kind.startswith(("u", "b"))}
_MOST_CHAINED = 8


def field_type(kind: str, bits: int) -> str | None:
    """Our type of an entry with a type of the file and so many bits; None where there is none that means the same.

    Fewer bits than those of an unsigned number are the lower ones of it.
    """
    ours = _OURS.get(kind)
    if ours is None or BITS[ours] == bits:
        return ours
    return unsigned_type(bits) if ours.startswith("u") and unsigned_type(bits) in PACKED else None


def unsigned_type(bits: int) -> str | None:
    """Our type of so many bits that mean nothing, or nothing that we know of."""
    return _UNSIGNED.get(bits)


def known_type(said: str, own_types: Mapping[str, str]) -> str:
    """A type as `field_type` knows it, of a file's own that which it is based on; else as it is `said`."""
    name = said
    for _ in range(_MOST_CHAINED):
        if name.upper() in _OURS:
            return name.upper()
        name = own_types.get(name, "")
    return said
