"""Installed drivers: found by entry point, held against their contract, and named where an error is theirs.

What can be seen of a class without hardware is judged here; what it does on its bus is for the conformance suite.
"""

from __future__ import annotations

import contextlib
import inspect
import re
import traceback
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from micromanip.errors import ConfigError, did_you_mean

from .cyclic import CyclicDriver
from .driver import BusDriver, BusOptions

GROUP = "micromanip.drivers"
KINDS: dict[str, type] = {"cyclic": CyclicDriver, "bus": BusDriver}
_SIGNATURES = {
    "cyclic": {"__init__": ["options", "period_ns"]},
    "bus": {
        "__init__": ["options", "folder"],
        "perform": ["task", "values", "inbox"],
        "receive": ["inbox", "until_ns"],
        "probe": ["seconds"],
    },
}
_OURS = ("micromanip", "micromanip_drivers")
_COMPILER = "numba"
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_NO_CAUSE = ("Failed in ", "During: ", "Overload ", "There are ")


def installed() -> dict[str, EntryPoint]:
    """All installed drivers by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


def driver_class(name: str) -> type[CyclicDriver] | type[BusDriver]:
    """Class of the driver called `name`; raises ConfigError where it is not there, is none, or lacks a member."""
    points = installed()
    if name not in points:
        hint = did_you_mean(name, sorted(points), "installed are:")
        raise ConfigError(f"no driver called {name} is installed; {hint}")
    found, reason = _loaded(points[name])
    if reason is not None:
        raise ConfigError(f"driver {name} ({points[name].value}) {reason}")
    if kind_of(found) is None or found.__abstractmethods__:
        raise ConfigError(f"driver {name} ({points[name].value}) {findings(found)[0]}; tell its author")
    driver: type[CyclicDriver] | type[BusDriver] = found
    return driver


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
    found, reason = _loaded(point)
    if reason is not None:
        return Inspected(point.name, None, package, version, point.value, None, (reason,))
    own, file = getattr(found, "version", ""), None
    with contextlib.suppress(TypeError, OSError):
        file = inspect.getfile(found)
    version = own if isinstance(own, str) and own else version
    return Inspected(point.name, kind_of(found), package, version, point.value, file, tuple(findings(found)))


def _loaded(point: EntryPoint) -> tuple[Any, str | None]:
    """What it leads to, or why that can't be loaded."""
    try:
        return point.load(), None
    except (Exception, SystemExit) as problem:  # whatever the author's module does when it is imported
        return None, f"can't be loaded: {type(problem).__name__}: {problem}"


def kind_of(found: Any) -> str | None:
    """Which kind of driver it is, "cyclic" or "bus"; None for what is none."""
    if not isinstance(found, type):
        return None
    return next((kind for kind, base in KINDS.items() if issubclass(found, base)), None)


def findings(found: Any) -> list[str]:
    """What is wrong with the class of a driver, a clause each, the worst first; empty for a good one."""
    kind = kind_of(found)
    if kind is None:
        bases = " or ".join(f"micromanip.driver.{base.__name__}" for base in KINDS.values())
        return [f"is not a class derived from {bases}"]
    missing = sorted(found.__abstractmethods__)
    problems = [f"does not have {', '.join(missing)}"] if missing else []
    if not found.__dict__.get("__doc__"):
        problems.append("has no docstring that says what it drives")
    problems += _of_options(getattr(found, "Options", None), BusOptions if kind == "bus" else BaseModel)
    return problems + [
        f"{name} does not take ({', '.join(arguments)})"
        for name, arguments in _SIGNATURES[kind].items()
        if list(inspect.signature(getattr(found, name)).parameters)[1:] != arguments
    ]


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


def _is_section(annotation: Any) -> bool:
    """Whether it holds a model, whose keys are described there."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return True
    return any(_is_section(part) for part in get_args(annotation))


def driver_at_fault(problem: BaseException) -> str | None:
    """The driver, its package and the place, where `problem` is an error of one of others'; None where it is ours.

    An error belongs to the last of both whose code was running. What the compiler refuses is the author's, too,
    though the compiler was called by us.
    """
    points = {point.module.partition(".")[0]: point for _, point in sorted(installed().items())}
    frames = [
        (str(frame.f_globals.get("__name__", "")).partition(".")[0], f"{frame.f_code.co_filename}:{line}")
        for frame, line in traceback.walk_tb(problem.__traceback__)
    ]
    theirs = {root: point for root, point in points.items() if root not in _OURS}
    while_compiling = any(root == _COMPILER for root, _ in frames)
    known = [(root, place) for root, place in frames if root in theirs or (root in _OURS and not while_compiling)]
    if not known or known[-1][0] not in theirs:
        return None
    root, place = known[-1]
    point = theirs[root]
    package = f"{point.dist.name} {point.dist.version}" if point.dist else point.value
    return f"the driver {point.name} ({package}), {_compiled_at(problem, root) or place}"


def first_cause(problem: BaseException) -> str:
    """What `problem` says, in a line; of a compiler's page the reason."""
    lines = [line.strip() for line in _COLOUR.sub("", str(problem)).splitlines() if line.strip()]
    said = next((line for line in lines if not line.startswith(_NO_CAUSE)), "")
    return f"{type(problem).__name__}: {said}" if said else type(problem).__name__


def _compiled_at(problem: BaseException, root: str) -> str | None:
    """The innermost line of the package `root` that the compiler names, which it names first."""
    named = re.findall(r'File "([^"]+)", line (\d+)', _COLOUR.sub("", str(problem)))
    return next((f"{file}:{line}" for file, line in named if root in Path(file).with_suffix("").parts), None)
