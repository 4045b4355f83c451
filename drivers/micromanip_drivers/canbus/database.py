"""The DBC file of a bus: loaded by cantools, with clear words for what is wrong in it or not there.

cantools refuses a whole file for what nobody here needs of it: that is taken out before. Lines stay where they are, so
that a message names the right one.
"""

from __future__ import annotations

import logging
import math
import re
from pathlib import Path
from typing import Any

import cantools
from cantools.database.errors import UnsupportedDatabaseFormatError

from micromanip.driver import CLASSIC_LENGTHS, FD_LENGTHS, ConfigError, did_you_mean, require_regular

from ..saved_text import decoded
from .plan import GREATEST

_STRING = r'"(?:\\"|[^"\\]|\\(?!"))*"'
_WORDS = rf'(?:VAL_[ \t]+[^";\n]*(?:{_STRING}[^";A-Za-z_]*)*|CM_[ \t]+[^";\n]*{_STRING}\s*);'
_MESSAGE = r"BO_\s+(?P<id>\d{1,10})\s+(?P<name>\w+)\s*:[^\n]*(?:\n[ \t]*SG_\s[^\n]*)*"
_PARTS = re.compile(rf"^[ \t]*(?:(?P<words>{_WORDS})|(?P<message>{_MESSAGE}))|{_STRING}", re.MULTILINE)
_FLOATS = re.compile(r"^[ \t]*(?:SIG_VALTYPE_|SIGTYPE_VALTYPE_)\s+(\d+)[^;\n]*;", re.MULTILINE)
_EMPTY = 'VERSION ""'
"""What cantools takes for a file of nothing."""
_EXTENDED, _OF_NO_MESSAGE = 1 << 31, 0xC000_0000
"""The bit of an extended identifier, and the identifier of a message that holds signals of none."""


# its warnings are about messages that we refuse in words of our own, where they matter
logging.getLogger("cantools").addHandler(logging.NullHandler())

_MOST_BYTES = 20_000_000
_MOST_BITS = 64


class Database:
    """Messages of a DBC file. Raises ConfigError if it can't be read.

    Only a message that is asked for has to make sense: files of whole machines have some that don't.
    """

    def __init__(self, file: Path) -> None:
        self.name = file.name
        self._file, self._text = file, ""
        try:
            require_regular(file, _MOST_BYTES)
            self._text = decoded(file.read_bytes(), "cp1252")
            text, self._impossible = usable(self._text)
            self._database: Any = cantools.database.load_string(text, database_format="dbc", strict=False)
        except OSError as error:
            raise ConfigError(f"database: {file} can't be read: {error.strerror}") from error
        except UnsupportedDatabaseFormatError as error:
            raise self._refused(_said(error.e_dbc)) from error
        except cantools.Error as error:  # a signal without bits
            raise self._refused(str(error)) from error

    def by_identifier(self) -> dict[tuple[int, bool], Any]:
        """The messages by (identifier, extended)."""
        return {identity(message): message for message in self._database.messages}

    def message(self, key: str, name: str) -> Any:
        """The message of that name, which the configuration has at `key`. Raises ConfigError if there is none."""
        if name in self._impossible:
            raise self._refused(self._impossible[name])
        names = [message.name for message in self._database.messages]
        if name not in names:
            raise ConfigError(f"{key}: {self.name} has no message {name}; {did_you_mean(name, names)}")
        if (many := names.count(name)) > 1:
            raise ConfigError(f"{key}: {self.name} has {many} messages {name}: give each a name of its own")
        message = self._database.messages[names.index(name)]
        self._must_be_alone(key, message)
        if (why := nonsense(message)) is not None:
            raise self._refused(why)
        _must_be_plain(key, message)
        return message

    def _must_be_alone(self, key: str, message: Any) -> None:
        for other in self._database.messages:
            if other is not message and identity(other) == identity(message):
                both = f"{message.name} and {other.name} both have the identifier {message.frame_id:#x} in {self.name}"
                raise ConfigError(f"{key}: {both}: frames cannot be distinguished")

    def _refused(self, why: str) -> ConfigError:
        """What is said against the file, behind the line that is named in it, or that of the message that is."""
        line = None
        if found := re.search(r" at line (\d+)", why):
            line = int(found[1])
        elif (named := re.search(r"\bmessage (\w+)", why)) and (
            at := re.search(rf"(?m)^\s*BO_\s+\d+\s+{named[1]}\b", self._text)
        ):
            line = 1 + self._text.count("\n", 0, at.end())
        what = "it is not a DBC file" if "syntax" in why else "it makes no sense"
        return ConfigError(f"database: {self._file}{f':{line}' if line else ''}: {what}: {' '.join(why.split())}")


def _said(problem: Exception | None) -> str:
    """In words: of an attribute that is not defined cantools says its name only, by a KeyError."""
    return f"{problem} is used and not defined (BA_DEF_)" if isinstance(problem, KeyError) else str(problem)


def nonsense(message: Any) -> str | None:
    """What makes no sense in a message of cantools, so that nobody can read or write its signals; None for nothing."""
    try:
        message.refresh(strict=True)  # signals that overlap, or lie outside of their message
    except cantools.Error as error:
        return str(error)
    for one in message.signals:
        if one.is_float and one.length not in GREATEST:
            return f"The signal {one.name} is a floating-point number of {one.length} bits in message {message.name}."
        if one.length > _MOST_BITS:
            return f"The signal {one.name} has {one.length} bits, more than {_MOST_BITS}, in message {message.name}."
        if not _scales(one):
            scaling = f"scale {one.scale} and offset {one.offset}"
            return f"The signal {one.name} has {scaling}, which give no values, in message {message.name}."
    if message.dbc and "CANFD_BRS" in message.dbc.attributes and _attribute(message, "CANFD_BRS") not in (0, 1):
        return f"The attribute CANFD_BRS is neither 0 nor 1 in message {message.name}."
    return None


def is_multiplexed(message: Any) -> bool:
    """Whether signals of a message of cantools lie over each other; also where its multiplexer (M) is missing."""
    return any(one.is_multiplexer or one.multiplexer_ids for one in message.signals)


def _scales(signal: Any) -> bool:
    """Whether each value within its limits has a code, and each code a value."""
    scale, offset = float(signal.scale), float(signal.offset)
    ends = [float(end) for end in (signal.minimum, signal.maximum) if end is not None]
    return scale != 0.0 and all(map(math.isfinite, (scale, offset, *((end - offset) / scale for end in ends))))


def signal(key: str, message: Any, name: str) -> Any:
    """The signal of that name in a message of cantools. Raises ConfigError if there is none."""
    for found in message.signals:
        if found.name == name:
            return found
    names = [found.name for found in message.signals]
    raise ConfigError(f"{key}: {message.name} has no signal {name}; {did_you_mean(name, names)}")


def whole_number(key: str, message: Any, name: str) -> Any:
    """A signal that counts or tells a state: whole numbers as they are. Raises ConfigError for any other."""
    found = signal(key, message, name)
    if found.is_float or found.is_signed or found.scale != 1 or found.offset != 0:
        raise ConfigError(f"{key}: {message.name}.{name} must be unsigned, with scale 1 and offset 0")
    return found


def counts(signal: Any) -> int:
    """After how many a signal of cantools that counts begins anew: behind its maximum where it has one."""
    most: int = (1 << signal.length) - 1
    return 1 + min(most, int(signal.maximum or most))


def identity(message: Any) -> tuple[int, bool]:
    """(identifier, extended) of a message of cantools."""
    return message.frame_id, message.is_extended_frame


def switches_bitrate(message: Any) -> bool:
    """If a CAN FD message of cantools has its data at the higher rate: as the attribute CANFD_BRS says, else it has."""
    return _attribute(message, "CANFD_BRS") != 0


def start_value(signal: Any) -> float:
    """What a signal of cantools begins with: its GenSigStartValue, or the file's default of that; 0 without either.

    A default of 0 is what editors put there by themselves: a code that is not meant to be one.
    """
    own = signal.raw_initial
    code = own if own is not None else _attribute(signal, "GenSigStartValue") or None
    return 0.0 if code is None else float(code * signal.scale + signal.offset)


def _attribute(described: Any, name: str) -> float | None:
    """The number that an attribute of a message or a signal is, of an ENUM the place in it; where it has none of its
    own it is the file's default, which programs don't repeat.
    """
    if described.dbc is None:  # made by hand, of no file
        return None
    own, definition = (named.get(name) for named in (described.dbc.attributes, described.dbc.attribute_definitions))
    value = own.value if own is not None else definition.default_value if definition is not None else None
    if isinstance(value, str) and definition.choices and value in definition.choices:
        value = definition.choices.index(value)
    return value if isinstance(value, int | float) else None


def _must_be_plain(key: str, message: Any) -> None:
    if is_multiplexed(message):
        raise ConfigError(
            f"{key}: {message.name} is multiplexed (m0, m1, ... in the DBC), which is not supported: "
            "give each group of signals a message of its own"
        )
    lengths, kind = (FD_LENGTHS, "CAN FD") if message.is_fd else (CLASSIC_LENGTHS, "classic CAN")
    if message.length not in lengths or not message.length:
        hint = "" if message.is_fd or message.length <= 8 else _of_long(message)
        raise ConfigError(f"{key}: {message.name} has {message.length} bytes, which {kind} has not{hint}")


def _of_long(message: Any) -> str:
    if message.protocol == "j1939":
        return ": J1939 sends it in several frames, which is not supported"
    return f": for CAN FD give it VFrameFormat {'Extended' if message.is_extended_frame else 'Standard'}CAN_FD"


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
