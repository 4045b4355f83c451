"""A Dask scheduler that takes work: all that joblib shares out, or calls of one function."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import joblib

from micromanip.errors import DeviceUnavailable, UsageError

_ANSWERS_S = 10


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """A client (`distributed.Client`) of the scheduler at `address`, e.g. tcp://host:8786.

    Raises UsageError without the extra `cluster`, DeviceUnavailable where nobody answers.
    """
    try:
        from distributed import Client
    except ImportError as problem:
        raise UsageError("a cluster needs the packages of the extra: pip install 'micromanip[cluster]'") from problem
    try:
        connect: Any = Client
        client = connect(address, timeout=_ANSWERS_S)
    except (OSError, ValueError) as problem:
        raise DeviceUnavailable(f"no Dask scheduler answers at {address}: {problem}") from problem
    with client:
        yield client


@contextmanager
def cluster(address: str) -> Iterator[None]:
    """All parallel work of joblib inside goes to the Dask scheduler at `address`; raises as `connected`."""
    with connected(address), joblib.parallel_config(backend="dask"):
        yield
