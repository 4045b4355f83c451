"""The tunings shared out to workers, and again what a worker that died has taken with it."""

from __future__ import annotations

from collections.abc import Callable

from micromanip.errors import DeviceUnavailable

from .sharing import Share, WorkerDiedError
from .store import Store
from .work import Work

BATCH = 25
"""Tunings that a worker takes at a time: half a second."""
_DEATHS_WITHOUT_RESULT = 5


def run_trials(
    store: Store, work: Work, number: int, share: Share, done: Callable[[int], None] = lambda _: None
) -> None:
    """Try the tunings 0 .. `number` that `store` lacks, on the workers that `share` hands them to.

    `done` hears how many have been kept. A worker that is killed costs what it was about, which others do again: each
    tuning follows from its number, so the results are the same. Raises DeviceUnavailable where workers die and die.
    """
    deaths = 0
    while missing := store.missing(number):
        kept = False
        try:
            for tried in share(work, [missing[k : k + BATCH] for k in range(0, len(missing), BATCH)]):
                store.add(tried)
                kept = True
                done(len(tried))
        except WorkerDiedError as problem:
            deaths = 0 if kept else deaths + 1
            if deaths == _DEATHS_WITHOUT_RESULT:
                raise DeviceUnavailable(
                    f"workers die before they have a result, {deaths} times in a row: is there enough memory? What was "
                    f"tried is in {store.file}"
                ) from problem
