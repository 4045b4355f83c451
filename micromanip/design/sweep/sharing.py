"""Who tries batches of tunings: processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from typing import Any, TypeAlias

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from micromanip.design.cluster import connected
from micromanip.errors import DeviceUnavailable

from .work import Tried, Work, try_some

Share: TypeAlias = Callable[[Work, list[list[int]]], Iterator[list[Tried]]]
"""Results of batches of numbers, as they come. Raises WorkerDiedError."""


class WorkerDiedError(Exception):
    """A worker was killed, and what it was about has to be done again."""


def on_processes(jobs: int) -> Share:
    """`jobs` processes here, -1 for one a CPU."""

    def share(work: Work, batches: list[list[int]]) -> Iterator[list[Tried]]:
        run = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
        try:
            yield from run(joblib.delayed(try_some)(work, batch) for batch in batches)
        except TerminatedWorkerError as problem:
            raise WorkerDiedError(str(problem)) from problem

    return share


def on_cluster(address: str) -> Share:
    """The workers of the Dask scheduler at `address`; raises as `connected`, DeviceUnavailable where it goes.

    The work is a task that the others depend on: it is sent once, and done again where its worker is killed.
    """

    def share(work: Work, batches: list[list[int]]) -> Iterator[list[Tried]]:
        with connected(address) as client:
            import dask
            import distributed

            with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TB"}):
                held = client.submit(_held, work, pure=False)
            as_they_come: Any = distributed.as_completed
            futures = client.map(try_some, [held] * len(batches), batches, pure=False)
            try:
                for future in as_they_come(futures):
                    yield future.result()
                    future.release()
            except distributed.KilledWorker as problem:
                raise WorkerDiedError(str(problem)) from problem
            except (CancelledError, OSError) as problem:
                raise DeviceUnavailable(f"the Dask scheduler at {address} has gone: {problem}") from problem

    return share


def _held(work: Work) -> Work:
    return work
