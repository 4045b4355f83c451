"""A node's object dictionary, as its EDS file describes it."""

from __future__ import annotations

import configparser
import logging
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

from canopen.objectdictionary import ObjectDictionary, ObjectDictionaryError, ODVariable, import_od

from micromanip.driver import ConfigError, did_you_mean, require_regular

from .eds_text import objects_of

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
