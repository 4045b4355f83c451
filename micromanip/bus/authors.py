"""Whose error it is that nobody foresaw: a driver's, where it was raised in the code of one that others wrote."""

from __future__ import annotations

import re
import traceback
from importlib.metadata import EntryPoint
from pathlib import Path

from .registry import installed

_OURS = ("micromanip", "micromanip_drivers")
_COMPILER = "numba"
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_NO_CAUSE = ("Failed in ", "During: ", "Overload ", "There are ")


def driver_at_fault(problem: BaseException) -> str | None:
    """The driver, its package and the place, where `problem` is an error of it; None where it is ours.

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
    return f"the driver {theirs[root].name} ({_package(theirs[root])}), {_compiled_at(problem, root) or place}"


def first_cause(problem: BaseException) -> str:
    """What `problem` says, in a line; of a compiler's page the reason."""
    lines = [line.strip() for line in _COLOUR.sub("", str(problem)).splitlines() if line.strip()]
    said = next((line for line in lines if not line.startswith(_NO_CAUSE)), "")
    return f"{type(problem).__name__}: {said}" if said else type(problem).__name__


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def _compiled_at(problem: BaseException, root: str) -> str | None:
    """The innermost line of the package `root` that the compiler names, which it names first."""
    named = re.findall(r'File "([^"]+)", line (\d+)', _COLOUR.sub("", str(problem)))
    return next((f"{file}:{line}" for file, line in named if root in Path(file).with_suffix("").parts), None)
