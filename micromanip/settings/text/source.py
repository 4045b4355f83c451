"""Where a configuration came from: its text, and the line of every key, for messages that point at it."""

from __future__ import annotations

import hashlib
import json
import pathlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from micromanip.errors import ConfigError
from micromanip.files import marked_encoding, open_regular
from micromanip.shipped import shipped

from . import yaml_nodes
from .place import Finding, Path
from .yaml_text import Problem

_MAX_BYTES = 1_000_000  # a configuration has some 10 kB; whoever names a recording by mistake gets an answer at once
_MAX_SHOWN = 10
_LONGEST = 1_000

KeyPath = str | Sequence[str | int]


@dataclass(frozen=True)
class Source:
    """A configuration file as read, or a document that stands in no file and has no lines."""

    path: pathlib.Path
    text: str
    data: Any
    lines: dict[Path, int]
    in_file: bool = True

    @classmethod
    def read(cls, file: pathlib.Path) -> Source:
        """Read and parse a file; ConfigError if there is none, or what it holds isn't YAML."""
        return cls.parse(file, _read_text(file))

    @classmethod
    def parse(cls, file: pathlib.Path, text: str) -> Source:
        """`text` as if `file` held it; ConfigError where it isn't YAML."""
        document = yaml_nodes.parse(text)
        source = cls(file, text, document.data, document.lines)
        if document.problems:
            raise source.report(document.problems)
        return source

    @classmethod
    def of(cls, data: Any, file: pathlib.Path) -> Source:
        """A document of JSON's types, such as a running configuration with changes.

        Messages name its keys alone; relative paths in it begin where `file` is.
        """
        return cls(file, json.dumps(data) + "\n", data, {}, in_file=False)

    @property
    def hash(self) -> str:
        """SHA-256 of the text, which names this very configuration in recordings."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def error(self, path: KeyPath, message: str) -> ConfigError:
        """One thing that is wrong, at a key path: ``"axes.x.inner.Ti_ms"``, ``("axes", "x", "centre_um")``."""
        return self.errors([(path, message)])

    def error_below(self, path: Path, message: str) -> ConfigError:
        """As `error`, of who doesn't know the file: at the key below `path` that the message begins with, if it does.

        ``"receive.Sensors.counter: there is no such signal"``.
        """
        below, colon, text = message.partition(": ")
        found = (*path, *below.split("."))
        return self.error(found, text) if colon and found in self.lines else self.error(path, message)

    def errors(self, findings: Iterable[tuple[KeyPath, str]]) -> ConfigError:
        """Several things that are wrong, each at its key path."""
        paths = [(tuple(path.split(".")) if isinstance(path, str) else tuple(path), text) for path, text in findings]
        return self.report(Problem(self._line(path), path, _one_line(text)) for path, text in paths)

    def sentences(self, findings: Iterable[Finding]) -> list[str]:
        """What is no error, a line each, in the order in which it was found."""
        return [self._sentence(Problem(self._line(path), path, _one_line(text))) for path, text in findings]

    def report(self, problems: Iterable[Problem]) -> ConfigError:
        """Problems in the order of the file, a line each."""
        ordered = sorted(problems, key=lambda problem: problem.line)
        lines = [self._sentence(problem) for problem in ordered[:_MAX_SHOWN]]
        if more := len(ordered) - _MAX_SHOWN:
            lines += [f"{self.path}: and {more} more" if self.in_file else f"and {more} more"] * (more > 0)
        return ConfigError("\n".join(lines))

    def _sentence(self, problem: Problem) -> str:
        where = f"{self.path}:{problem.line}: " if self.in_file else ""
        return f"{where}{key_text(problem.path)}: {problem.text}" if problem.path else where + problem.text

    def _line(self, path: Path) -> int:
        """Line of a key, or of the innermost section around it that stands in the file."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


def _one_line(text: str) -> str:
    """A message as one line that a terminal can show, whatever it quotes."""
    line = " ".join(text.split())
    shown = "".join(character if character.isprintable() else ascii(character)[1:-1] for character in line)
    return shown if len(shown) <= _LONGEST else f"{shown[:_LONGEST]} ..."


def key_text(path: Path) -> str:
    """``axes.x.hysteresis.weights[3]``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{_shown(part)}" for part in path)
    return text.removeprefix(".")


def _shown(key: str) -> str:
    """A key as it stands in the file, quoted where it would garble the message."""
    return key if key.isprintable() and key.strip() and len(key) <= 60 else ascii(key[:60])


def _read_text(file: pathlib.Path) -> str:
    try:
        with open_regular(file) as stream:
            content = stream.read(_MAX_BYTES + 1)
    except FileNotFoundError:
        raise ConfigError(f"{file}: no such file; {shipped('config')} has examples") from None
    except IsADirectoryError:
        raise ConfigError(f"{file}: a directory; name the YAML file in it") from None
    except OSError as error:
        raise ConfigError(f"{file}: can't be read: {error.strerror}") from None
    if len(content) > _MAX_BYTES:
        raise ConfigError(f"{file}: larger than {_MAX_BYTES // 1000} kB; is it really a configuration?")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        told = f"not UTF-8 text (byte 0x{content[error.start]:02x})"
        if marked_encoding(content) == "utf-16":
            told += ": it is UTF-16, as Windows writes what it calls Unicode"
        elif b"\0" in content[:1000]:
            raise ConfigError(f"{file}:{line}: {told}: no text at all; name the YAML file") from None
        raise ConfigError(f"{file}:{line}: {told}; save it as UTF-8") from None
