"""Caches results of costly functions of matrices, by their exact arguments.

A change of a tuning leaves most equations unchanged: a regulator's weight does not affect the observer, and one axis
not the others. Each `set` and the drawn tunings of `replay --vary` profit.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar, TypeVarTuple

import numpy as np

Given = TypeVarTuple("Given")
Result = TypeVar("Result")


@dataclass(frozen=True)
class _Given:
    """Arguments, compared bit by bit, and passed on unchanged: their order in memory affects how BLAS rounds."""

    key: tuple[object, ...]
    arguments: tuple[Any, ...] = field(compare=False)


def cached_arrays(size: int) -> Callable[[Callable[[*Given], Result]], Callable[[*Given], Result]]:
    """Keep the last `size` results of a function of arrays and numbers; the results are read-only."""

    def decorate(function: Callable[[*Given], Result]) -> Callable[[*Given], Result]:
        @functools.lru_cache(size)
        def of(given: _Given) -> Result:
            return function(*given.arguments)

        @functools.wraps(function)
        def ask(*arguments: *Given) -> Result:
            key = ((each.shape, each.tobytes()) if isinstance(each, np.ndarray) else each for each in arguments)
            return of(_Given(tuple(key), arguments))

        return ask

    return decorate
