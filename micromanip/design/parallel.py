"""Work shared out by joblib: to processes of this machine, or to the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from micromanip.errors import DeviceUnavailable
from micromanip.extras import required

_ANSWERS_S = 10

Result = TypeVar("Result")


def each(
    function: Callable[..., Result], items: Iterable[Any], jobs: int | None = None, shared: tuple[Any, ...] = ()
) -> Iterator[Result]:
    """``function(item, *shared)`` for all `items`, in their order, on `jobs` processes or where `scheduler` says.

    Arrays of a megabyte and more are files that the processes map. Raises DeviceUnavailable where a process of this
    machine is killed.
    """
    run = joblib.Parallel(n_jobs=jobs, return_as="generator", mmap_mode="c")
    try:
        yield from run(joblib.delayed(function)(item, *shared) for item in items)
    except TerminatedWorkerError as problem:
        raise DeviceUnavailable("a worker process was killed; is there enough memory? Try fewer --jobs") from problem


@contextmanager
def scheduler(address: str, *shared: object) -> Iterator[None]:
    """Let the Dask scheduler at `address`, e.g. tcp://host:8786, take the work of `each` inside.

    Every worker gets one copy of each object that `each` is told as `shared`. The calls of a killed worker go to the
    others. Raises DeviceUnavailable without the extra `cluster`, where no scheduler answers, or where all workers
    with a copy are gone.
    """
    with required("a Dask scheduler", "cluster"):
        from distributed import CancelledError, Client, KilledWorker
    connect: Any = Client
    try:
        client = connect(address, timeout=_ANSWERS_S)
    except (OSError, ValueError) as problem:
        raise DeviceUnavailable(f"no Dask scheduler answers at {address}: {problem}") from problem
    with client:
        try:
            with joblib.parallel_config(backend="dask", scatter=list(shared) or None):
                yield
        except (CancelledError, KilledWorker, OSError) as problem:
            raise DeviceUnavailable(f"the Dask scheduler at {address} lost the work: {problem}") from problem
