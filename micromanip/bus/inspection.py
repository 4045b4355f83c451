"""Does a driver's class keep its contract, as far as that can be seen without hardware?"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from .cyclic import CyclicDriver
from .driver import BusDriver, BusOptions
from .registry import installed

KINDS: dict[str, type] = {"cyclic": CyclicDriver, "bus": BusDriver}


@dataclass(frozen=True)
class Inspected:
    """An installed driver, as it is found."""

    name: str
    kind: str | None
    """Which it is, "cyclic" or "bus"; None where that can't be seen."""
    package: str
    version: str
    entry_point: str
    file: str | None
    """Where its class stands; None where it can't be loaded."""
    problems: tuple[str, ...]
    """Why it can't be loaded, or what its class lacks; empty for a good one."""


def inspected() -> list[Inspected]:
    """All installed drivers, by name."""
    return [_inspect(point) for _, point in sorted(installed().items())]


def _inspect(point: EntryPoint) -> Inspected:
    package, version = (point.dist.name, point.dist.version) if point.dist else ("?", "?")
    try:
        found = point.load()
    except (Exception, SystemExit) as problem:  # whatever the author's module does when it is imported
        reason = f"can't be loaded: {type(problem).__name__}: {problem}"
        return Inspected(point.name, None, package, version, point.value, None, (reason,))
    own = getattr(found, "version", "")
    return Inspected(
        point.name,
        kind_of(found),
        package,
        own if isinstance(own, str) and own else version,
        point.value,
        _file(found),
        tuple(findings(found)),
    )


def _file(found: Any) -> str | None:
    try:
        return str(Path(inspect.getfile(found)))
    except (TypeError, OSError):
        return None


def kind_of(found: Any) -> str | None:
    """Which kind of driver it is, "cyclic" or "bus"; None for what is none."""
    if not isinstance(found, type):
        return None
    return next((kind for kind, base in KINDS.items() if issubclass(found, base)), None)


def findings(found: Any) -> list[str]:
    """What is wrong with the class of a driver, a clause each; empty for a good one."""
    if kind_of(found) is None:
        bases = " or ".join(f"micromanip.driver.{base.__name__}" for base in KINDS.values())
        return [f"is not a class derived from {bases}"]
    missing = sorted(found.__abstractmethods__)
    problems = [f"does not have {', '.join(missing)}"] if missing else []
    if not found.__dict__.get("__doc__"):
        problems.append("has no docstring that says what it drives")
    problems += _of_options(getattr(found, "Options", None), BusOptions if issubclass(found, BusDriver) else BaseModel)
    return problems + (_of_bus(found) if issubclass(found, BusDriver) else _of_cyclic(found))


def _of_options(options: Any, base: type[BaseModel]) -> list[str]:
    if not (isinstance(options, type) and issubclass(options, base)):
        home = "micromanip.driver" if base is BusOptions else "pydantic"
        return [f"Options is not a model derived from {home}.{base.__name__}"]
    problems: list[str] = []
    if options.model_config.get("extra") != "forbid":
        problems.append('Options accepts unknown keys: a typing error would pass; say extra="forbid"')
    bare = [
        name
        for name, field in options.model_fields.items()
        if not field.description and name != "driver" and not _is_section(field.annotation)
    ]
    if bare:
        problems.append(f"Options does not describe {', '.join(bare)}")
    return problems


def _of_bus(found: type[BusDriver]) -> list[str]:
    problems: list[str] = [] if isinstance(found.version, str) else ["version is not a text"]
    wanted = {
        "__init__": ["options", "folder"],
        "perform": ["task", "values", "inbox"],
        "receive": ["inbox", "until_ns"],
        "probe": ["seconds"],
    }
    return problems + [
        f"{name} does not take ({', '.join(arguments)})"
        for name, arguments in wanted.items()
        if list(inspect.signature(getattr(found, name)).parameters)[1:] != arguments
    ]


def _of_cyclic(found: type[CyclicDriver]) -> list[str]:
    problems = [] if isinstance(found.simulated, bool) else ["simulated is neither True nor False"]
    if not (found.watchdog is None or isinstance(found.watchdog, str)):
        problems.append("watchdog is neither a text nor None")
    if list(inspect.signature(found.__init__).parameters)[1:] != ["options", "period_ns"]:
        problems.append("__init__ does not take (options, period_ns)")
    return problems


def _is_section(annotation: Any) -> bool:
    """Whether it holds a model, whose keys are described there."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return True
    return any(_is_section(part) for part in get_args(annotation))
