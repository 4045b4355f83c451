"""A node's object dictionary: its EDS file, brought into the form that canopen reads, with the lines of what is wrong.

Makers write sections and keys in any case, indent them, save them by DOS, Windows or with a byte-order mark, and leave
empty what they do not use. canopen would refuse some of that and, worse, leave objects out in silence. Sections that do
not describe objects are left out here: nothing of them is used.

Objects whose parts an EDS or a DCF does not list one by one (CompactSubObj, CiA 306) are listed. Of these canopen
knows arrays only, and leaves out what their parts are set to (``[1600Value]``).
"""

from __future__ import annotations

import configparser
import io
import logging
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from canopen.objectdictionary import ObjectDictionary, ObjectDictionaryError, ODVariable, datatypes, import_od

from micromanip.driver import ConfigError, did_you_mean, require_regular

from ..saved_text import decoded

logging.getLogger("canopen").addHandler(logging.NullHandler())  # what goes wrong comes as an exception

_NUMBER = re.compile(r"^(?:0x)?([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]{1,2}))?$")
_MOST_BYTES = 20_000_000
PROCESS_DATA = range(0x2000, 0x10000)
"""Indices that carry process data; below them lies the communication."""


class Dictionary:
    """Objects of one node. Every method raises ConfigError, with the file's name, for what the EDS does not have."""

    def __init__(self, file: Path, node_id: int) -> None:
        self.file = file
        self.objects = _parsed(file, node_id)

    def variable(self, index: int, subindex: int = 0) -> ODVariable:
        """Object `index`, `subindex`."""
        found = self._get(index, subindex)
        if found is None:
            raise ConfigError(f"{self.file} has no object {number(index, subindex)}")
        return found

    def has(self, index: int, subindex: int = 0) -> bool:
        """True if there is an object `index`, `subindex`."""
        return self._get(index, subindex) is not None

    def value(self, index: int, subindex: int = 0) -> int:
        """What an integer object is when the device starts: its ParameterValue (DCF), or its DefaultValue."""
        variable = self.variable(index, subindex)
        what = f"{self.file}: object {number(index, subindex)} ({variable.name})"
        for key, said, value in (
            ("ParameterValue", getattr(variable, "value_raw", ""), variable.value),
            ("DefaultValue", getattr(variable, "default_raw", ""), variable.default),
        ):
            if isinstance(value, int):
                return value
            if said:
                raise ConfigError(f"{what}: {key} {said[:40]!r} is no number")
        raise ConfigError(f"{what} has no DefaultValue")

    def find(self, name: str) -> ODVariable:
        """The object called `name`, or with that number ("8130sub1")."""
        if match := _NUMBER.match(name):
            return self.variable(int(match[1], 16), int(match[2] or "0", 16))
        found = [v for v in self._variables() if name in (v.name, v.qualname)]
        if len(found) == 1:
            return found[0]
        if found:
            numbers = " and ".join(number(v.index, v.subindex) for v in found)
            raise ConfigError(f"{self.file} has several objects called {name}: give the number, {numbers}")
        known = [v.name for v in self._variables() if v.index in PROCESS_DATA]
        hint = did_you_mean(name, known, "its process data are")
        raise ConfigError(f"{self.file} has no object called {name}; {hint}")

    def _get(self, index: int, subindex: int) -> ODVariable | None:
        entry = self.objects.indices.get(index)
        if entry is None or isinstance(entry, ODVariable):
            return entry if subindex == 0 else None
        found: ODVariable | None = entry.subindices.get(subindex)
        return found

    def _variables(self) -> Iterator[ODVariable]:
        for entry in self.objects.values():
            if isinstance(entry, ODVariable):
                yield entry
            else:
                yield from entry.subindices.values()


def number(index: int, subindex: int = 0) -> str:
    """An object's number as the EDS writes it: "8130sub1"."""
    return f"{index:04X}sub{subindex:X}"


def _parsed(file: Path, node_id: int) -> ObjectDictionary:
    if file.suffix.lower() not in (".eds", ".dcf"):
        raise ConfigError(f"{file}: a file of CANopen objects ends in .eds or .dcf")
    try:
        require_regular(file, _MOST_BYTES)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the library's own, where it logs
            objects = import_od(objects_of(file), node_id)
    except OSError as problem:
        raise ConfigError(f"EDS file {file} can't be read: {problem.strerror}") from problem
    except (configparser.Error, UnicodeDecodeError, ValueError, KeyError, TypeError, ObjectDictionaryError) as problem:
        why = " ".join(str(problem).split())
        raise ConfigError(f"{file} is not a valid EDS file: {why}") from problem
    if not any(index >= 0x1000 for index in objects):
        raise ConfigError(f"{file} is not a valid EDS file: it describes no objects")
    return objects


_UNSIGNED8, _MOST = 5, 254
_OF_EACH = ("DataType", "AccessType", "PDOMapping", "LowLimit", "HighLimit", "DefaultValue", "Unit", "Factor")


_SECTION = re.compile(r"\[\s*([^\]]*?)\s*\]")
_OBJECT = re.compile(r"([0-9a-f]{1,4})(?:(sub)([0-9a-f]{1,2})|(name|value))?", re.IGNORECASE)
_DUMMIES = "DummyUsage"
_KEYS = {
    name.lower(): name
    for name in (
        *("ParameterName", "ObjectType", "DataType", "AccessType", "PDOMapping", "CompactSubObj", "StorageLocation"),
        *("LowLimit", "HighLimit", "DefaultValue", "ParameterValue", "Factor", "Description", "Unit", "NrOfEntries"),
        *(f"Dummy{number:04d}" for number in range(1, 8)),
    )
}
_NUMBERS = (
    "ObjectType",
    "DataType",
    "PDOMapping",
    "CompactSubObj",
    "NrOfEntries",
    *map("Dummy{:04d}".format, range(1, 8)),
)
_VALUES = ("DefaultValue", "ParameterValue", "LowLimit", "HighLimit")
_VARIABLE, _DOMAIN, _WITH_SUBS, _TYPES = 7, 2, (8, 9), (5, 6)


@dataclass
class _Section:
    """A section by canopen's name for it, with its line; values by canopen's names of the keys."""

    name: str
    line: int
    values: dict[str, str] = field(default_factory=dict)


def objects_of(file: Path) -> io.StringIO:
    """The sections of `file` that describe objects, each object before its parts, for ``canopen.import_od``.

    Raises ConfigError, as ``file:line: what``, for what is there twice, is missing or no number; OSError.
    """
    sections = _objects(_sections(file, decoded(file.read_bytes(), "latin-1")))
    for section in sections.values():
        _complete(file, section, sections)
    listed = whole({name: section.values for name, section in sections.items()})
    text = io.StringIO("[DeviceInfo]\n")  # which canopen would miss
    text.seek(0, io.SEEK_END)
    for name in sorted(listed, key=lambda each: len(each) > len("1000")):
        text.write(f"[{name}]\n" + "".join(f"{key}={value}\n" for key, value in listed[name].items()))
    text.seek(0)
    text.name = file.name
    return text


def _sections(file: Path, text: str) -> dict[str, _Section]:
    sections: dict[str, _Section] = {}
    section: _Section | None = None
    for line, said in enumerate(text.splitlines(), 1):
        stripped = re.sub(r"(^|\s);.*", "", said).strip()
        if not stripped or stripped.startswith("#"):
            continue
        if head := _SECTION.fullmatch(stripped):
            section = None
            if (name := _named(head[1])) is not None:
                if name in sections:
                    raise ConfigError(f"{file}:{line}: [{name}] is there already, in line {sections[name].line}")
                section = sections[name] = _Section(name, line)
        elif section is not None:
            _take(file, line, section, stripped)
    return sections


def _objects(sections: dict[str, _Section]) -> dict[str, _Section]:
    """Without the data types of the maker's own, and what belongs to them: they are no objects."""
    types = {name for name, each in sections.items() if int(each.values.get("ObjectType", _VARIABLE)) in _TYPES}
    return {name: each for name, each in sections.items() if _index(name) not in types}


def _index(name: str) -> str:
    """The section of the object that another section belongs to."""
    return name.partition("sub")[0].removesuffix("Name").removesuffix("Value")


def _named(said: str) -> str | None:
    """A section that is used, as canopen calls it; None for any other."""
    if said.lower() == _DUMMIES.lower():
        return _DUMMIES
    if (found := _OBJECT.fullmatch(said)) is None:
        return None
    index, sub, subindex, of_parts = found.groups()
    return index.upper() + (f"sub{subindex.upper()}" if sub else (of_parts or "").capitalize())


def _take(file: Path, line: int, section: _Section, said: str) -> None:
    key, equals, value = (part.strip() for part in said.partition("="))
    if not equals or not key:
        raise ConfigError(f"{file}:{line}: {said[:40]!r} in [{section.name}] is no KEY=VALUE")
    key = _KEYS.get(key.lower(), key)
    if key in section.values:
        raise ConfigError(f"{file}:{line}: {key} is in [{section.name}] twice")
    if key in _NUMBERS:
        if not value:
            return
        try:
            value = str(int(_without_zeros(value), 0))
        except ValueError:
            raise ConfigError(f"{file}:{line}: {key} {value[:40]!r} in [{section.name}] is no number") from None
    section.values[key] = value


def _without_zeros(value: str) -> str:
    """A number that begins with zeros, which canopen does not take, without them: octal (CiA 306) if it may be."""
    if re.fullmatch("0[0-9]+", value) is None:
        return value
    return str(int(value, 10 if set(value) & {"8", "9"} else 8))


def _complete(file: Path, section: _Section, sections: dict[str, _Section]) -> None:
    """Put in what may be left out (CiA 306), and refuse where more is."""
    name, values = section.name, section.values
    if name == _DUMMIES:
        values.update({f"Dummy{n:04d}": values.get(f"Dummy{n:04d}", "0") for n in range(1, 8)})
        return
    index = _index(name)
    if len(index) != len("1000"):  # a type of some editor's own
        return
    if index not in sections:
        raise ConfigError(f"{file}:{section.line}: [{name}] belongs to [{index}], which is not there")
    if name.endswith(("Name", "Value")):
        if name.endswith("Value") and _is_integer(sections[index].values):
            values.update({key: _without_zeros(value) for key, value in values.items()})
        return
    if values.get("CompactSubObj") == "0":
        del values["CompactSubObj"]
    wanted = ["ParameterName"]
    kind = int(values.get("ObjectType", _VARIABLE))
    if kind == _DOMAIN:
        values.setdefault("DataType", str(0xF))
        values.setdefault("AccessType", "rw")
    if _is_integer(values):
        values.update({key: _without_zeros(values[key]) for key in _VALUES if key in values})
    if kind not in _WITH_SUBS or "CompactSubObj" in values:
        wanted += ["DataType", "AccessType"]
    for key in wanted:
        if not values.get(key):
            raise ConfigError(f"{file}:{section.line}: [{name}] has no {key}")


def _is_integer(values: dict[str, str]) -> bool:
    return int(values.get("DataType", 0)) in datatypes.INTEGER_TYPES


def whole(sections: Mapping[str, Mapping[str, str]]) -> dict[str, Mapping[str, str]]:
    """Keys and values of each section, by its name; those of compact objects have become sections of their parts."""
    listed: dict[str, Mapping[str, str]] = {}
    for name, values in sections.items():
        if name.endswith(("Name", "Value")):
            continue
        listed[name] = values
        if "CompactSubObj" in values and "sub" not in name:
            names, set_to = (_by_subindex(sections.get(name + of_parts, {})) for of_parts in ("Name", "Value"))
            listed[name] = {key: value for key, value in values.items() if key != "CompactSubObj"}
            last = min(int(values["CompactSubObj"]), _MOST)
            listed[f"{name}sub0"] = _count(last)
            for k in range(1, last + 1):
                part = {key: values[key] for key in _OF_EACH if key in values}
                part["ParameterName"] = names.get(k, f"{values['ParameterName']}_{k:x}")
                if k in set_to:
                    part["ParameterValue"] = set_to[k]
                listed[f"{name}sub{k:X}"] = part
    return listed | {name: values for name, values in sections.items() if "sub" in name}


def _by_subindex(values: Mapping[str, str]) -> dict[int, str]:
    return {int(key): value for key, value in values.items() if key.isascii() and key.isdigit() and value}


def _count(last: int) -> Mapping[str, str]:
    return {
        "ParameterName": "Number of entries",
        "DataType": str(_UNSIGNED8),
        "AccessType": "ro",
        "DefaultValue": str(last),
    }
