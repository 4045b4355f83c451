"""What a driver has against its own options, said where the key stands."""

from __future__ import annotations

from micromanip.errors import ConfigError

from .source import Source


def driver_problem(source: Source, name: str, problem: ConfigError) -> ConfigError:
    """The `problem` of the driver called `name`, with file, line and key.

    A driver knows its own keys only; where it begins with one, "send.voltages.kind: ...", the message is at its line.
    """
    driver = ("drivers", name)
    keys, _, said = str(problem).partition(": ")
    path = (*driver, *keys.split("."))
    if said and path[:3] in source.lines:
        return source.error(path, said)
    return source.error(driver, str(problem))
