"""An ESI file as XML, each element with its line, and its numbers.

A document type, and with it any entity of the file's own, is refused: such a file may be small, its text endless.
"""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from micromanip.errors import ConfigError, system_error
from micromanip.files import open_regular

MOST_BYTES = 64 * 1024 * 1024
_MOST_DEEP = 100
_HEXADECIMAL = re.compile(r"(?:#x0x|#x|0x)([0-9a-f]{1,20})", re.IGNORECASE)
"""``#x1a00`` by ETG.2000; makers write the others as well."""
_DECIMAL = re.compile(r"[0-9]{1,20}", re.ASCII)  # 1_0, +1 and other scripts are none

_DECLARED = re.compile(rb"""\s*<\?xml\s[^>]*?encoding\s*=\s*["']([A-Za-z][\w.-]*)["']""")
_FAR_EAST = {
    **dict.fromkeys(("gb2312", "gbk"), "gb18030"),
    **dict.fromkeys(("shift_jis", "cp932"), "cp932"),
    **dict.fromkeys(("euc_kr", "cp949"), "cp949"),
    **{name: name for name in ("gb18030", "big5", "big5hkscs", "euc_jp")},
}
"""Encodings of several bytes a letter, which expat does not know, each by the widest of its kind."""


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
        encoding = _to_spare_expat(content)
        parser = expat.ParserCreate("utf-8" if encoding else None)
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
            parser.Parse(content.decode(encoding, "replace").encode() if encoding else content, True)
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


def _to_spare_expat(content: bytes) -> str | None:
    """The encoding of a file that expat can't read: one of several bytes a letter, or Windows' where UTF-8 was said."""
    declared = _DECLARED.match(content[:1000])
    try:
        name = codecs.lookup(declared[1].decode() if declared else "utf-8").name
    except LookupError:
        return None
    if name != "utf-8" or content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return _FAR_EAST.get(name)
    try:
        content.decode()
    except UnicodeDecodeError:
        return "cp1252"
    return None


def _local(name: str) -> str:
    """A tag without the prefix of its namespace."""
    return name.rpartition(":")[2]
