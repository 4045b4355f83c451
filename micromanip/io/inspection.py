"""Does a driver's class keep its contract, as far as that can be seen without hardware?"""

from __future__ import annotations

import inspect
from typing import Any, get_args

from pydantic import BaseModel

from .bus import BusDriver, BusOptions
from .contract import CyclicDriver

KINDS: dict[str, type] = {"cyclic": CyclicDriver, "bus": BusDriver}


def kind_of(found: Any) -> str | None:
    """Which kind of driver it is, "cyclic" or "bus"; None for what is none."""
    if not isinstance(found, type):
        return None
    return next((kind for kind, base in KINDS.items() if issubclass(found, base)), None)


def findings(found: Any) -> list[str]:
    """What is wrong with the class of a driver, a clause each; empty for a good one."""
    if kind_of(found) is None:
        bases = " or ".join(f"{base.__module__}.{base.__name__}" for base in KINDS.values())
        return [f"is not a class derived from {bases}"]
    missing = sorted(found.__abstractmethods__)
    problems = [f"does not have {', '.join(missing)}"] if missing else []
    if not found.__dict__.get("__doc__"):
        problems.append("has no docstring that says what it drives")
    problems += _of_options(getattr(found, "Options", None), BusOptions if issubclass(found, BusDriver) else BaseModel)
    return problems + (_of_bus(found) if issubclass(found, BusDriver) else _of_cyclic(found))


def _of_options(options: Any, base: type[BaseModel]) -> list[str]:
    if not (isinstance(options, type) and issubclass(options, base)):
        return [f"Options is not a model derived from {base.__module__}.{base.__name__}"]
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
