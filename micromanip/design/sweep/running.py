"""The tunings shared out to workers, and again what a worker that died has taken with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from micromanip.errors import DeviceUnavailable

from .store import Store
from .work import Tried, Work, try_some

BATCH = 25
"""Tunings that a worker takes at a time: half a second."""
_DEATHS_WITHOUT_RESULT = 5


def run_trials(
    store: Store,
    work: Work,
    number: int,
    jobs: int,
    done: Callable[[int], None] = lambda _: None,
    where: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> None:
    """Try the tunings 0 .. `number` that `store` lacks, on `jobs` processes or, within `where`, wherever that leads.

    `done` hears how many have been kept. A worker that is killed costs what it was about, which others do again: each
    tuning follows from its number, so the results are the same. Raises DeviceUnavailable where workers die and die.
    """
    deaths = 0
    while missing := store.missing(number):
        kept = False
        try:
            with where():
                for tried in _shared(work, missing, jobs):
                    store.add(tried)
                    kept = True
                    done(len(tried))
        except TerminatedWorkerError as problem:
            deaths = 0 if kept else deaths + 1
            if deaths == _DEATHS_WITHOUT_RESULT:
                raise DeviceUnavailable(
                    f"workers die before they have a result, {deaths} times in a row: is there enough memory? What was "
                    f"tried is in {store.file}"
                ) from problem


def _shared(work: Work, numbers: list[int], jobs: int) -> Iterator[list[Tried]]:
    batches = [numbers[k : k + BATCH] for k in range(0, len(numbers), BATCH)]
    run = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    found: Iterator[list[Tried]] = run(joblib.delayed(try_some)(work, batch) for batch in batches)
    return found
