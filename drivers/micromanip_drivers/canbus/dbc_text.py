"""A DBC as people write it, brought into what cantools reads: it refuses a whole file for what nobody here cares for.

Lines stay where they are, so that what is told of one is true.
"""

from __future__ import annotations

import re

_STRING = r'"(?:\\"|[^"\\]|\\(?!"))*"'
_WORDS = rf'(?:VAL_[ \t]+[^";\n]*(?:{_STRING}[^";A-Za-z_]*)*|CM_[ \t]+[^";\n]*{_STRING}\s*);'
_MESSAGE = r"BO_\s+(?P<id>\d{1,10})\s+(?P<name>\w+)\s*:[^\n]*(?:\n[ \t]*SG_\s[^\n]*)*"
_PARTS = re.compile(rf"^[ \t]*(?:(?P<words>{_WORDS})|(?P<message>{_MESSAGE}))|{_STRING}", re.MULTILINE)
_FLOATS = re.compile(r"^[ \t]*(?:SIG_VALTYPE_|SIGTYPE_VALTYPE_)\s+(\d+)[^;\n]*;", re.MULTILINE)
_EMPTY = 'VERSION ""'
"""What cantools takes for a file of nothing."""
_EXTENDED, _OF_NO_MESSAGE = 1 << 31, 0xC000_0000
"""The bit of an extended identifier, and the identifier of a message that holds signals of none."""


def usable(text: str) -> tuple[str, dict[str, str]]:
    """The text without comments and names of values, of which nothing is used, and messages that no bus can have.

    Those come by name, with what is wrong in each.
    """
    impossible: dict[str, str] = {}
    identifiers: set[str] = set()

    def part(found: re.Match[str]) -> str:
        if found["words"] is not None:
            return _only_lines(found[0])
        if found["message"] is not None and (why := _impossible(int(found["id"]))) is not None:
            impossible[found["name"]] = f"{why} in message {found['name']}."
            identifiers.add(found["id"])
            return _only_lines(found[0])
        return found[0]

    kept = _PARTS.sub(part, text)
    if identifiers:
        kept = _FLOATS.sub(lambda found: _only_lines(found[0]) if found[1] in identifiers else found[0], kept)
    return kept if kept.strip() else _EMPTY, impossible


def _impossible(said: int) -> str | None:
    """What is wrong with an identifier as the file has it; None for nothing."""
    identifier = said & ~_EXTENDED
    if said == _OF_NO_MESSAGE:
        return None
    if said & _EXTENDED:
        return f"Extended identifier {identifier:#x} has more than 29 bits" if identifier >> 29 else None
    if identifier >> 11:
        return f"Identifier {identifier:#x} has more than 11 bits and is not marked as extended (bit 31)"
    return None


def _only_lines(text: str) -> str:
    return "\n" * text.count("\n")
