"""Opening and closing: any number of times, in any state, and nothing moves by it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import pytest

from micromanip.bus.driver import BusDriver
from micromanip.bus.errors import IdentityMismatch, LinkError

from .hooks import Hooks, settle
from .session import Session, guarded


def descriptors() -> int:
    """Open descriptors of this process."""
    return len(list(Path("/proc/self/fd").iterdir()))


@dataclass(frozen=True)
class Held:
    """Counts of what a leak adds to."""

    descriptors: int
    threads: int
    maps: int

    @classmethod
    def now(cls) -> Self:
        """As the kernel sees it."""
        maps = Path("/proc/self/maps").read_bytes().count(b"\n")
        return cls(descriptors(), len(list(Path("/proc/self/task").iterdir())), maps)


_ROUNDS, _WARM_UP = 100, 10
_OPEN_S = 1.0


class LifetimeChecks(Hooks):
    """``open`` and ``close``."""

    def test_opened_100_times_leaves_nothing_behind(self) -> None:
        with self.device() as peer:
            driver = self.make(peer)
            before = Held.now()
            for turn in range(_WARM_UP + _ROUNDS):
                if turn == _WARM_UP:  # what a library loads or starts once and for all is no leak
                    time.sleep(0.05)
                    before = Held.now()
                with Session(driver):
                    pass
            settle(lambda: _no_more(Held.now(), before))
            after = Held.now()
        assert after.descriptors <= before.descriptors, (
            f"{after.descriptors - before.descriptors} descriptors more after {_ROUNDS} times open and close"
        )
        assert after.threads <= before.threads, f"{after.threads - before.threads} threads more after {_ROUNDS} times"
        assert after.maps < before.maps + _ROUNDS // 2, f"{after.maps - before.maps} memory maps more: one an open?"

    def test_closing_twice_and_unopened(self) -> None:
        with self.device() as peer:
            driver = self.make(peer)
            _close(driver, "close before any open")
            with Session(driver):
                pass
            _close(driver, "close for the second time")
            with Session(driver) as session:
                assert session.fresh() or not session.inputs, "no samples after it was closed twice and opened again"

    def test_no_device_is_a_lost_link_within_a_second(self) -> None:
        driver = self.make(self.peer())
        begin = time.monotonic()
        error = guarded(driver.open, "open")
        took_s = time.monotonic() - begin
        _close(driver, "close after an open that failed")
        assert isinstance(error, LinkError), f"open with no device there raised {error!r}, not a LinkError"
        assert str(error), "the LinkError says nothing; a user will read it"
        assert took_s < _OPEN_S + self.patience_s, f"open took {took_s:.2f} s with no device there; at most {_OPEN_S} s"

    def test_closing_after_a_failed_open(self) -> None:
        peer = self.peer()
        driver = self.make(peer)
        before = Held.now()
        for _ in range(3):
            guarded(driver.open, "open")
            _close(driver, "close after an open that failed")
        settle(lambda: _no_more(Held.now(), before))  # a bus in this process lets go of its end a moment later
        after = Held.now()
        assert after.descriptors <= before.descriptors, "opens that failed leave descriptors behind after close"
        peer.start()
        try:
            with Session(driver) as session:
                assert session.fresh() or not session.inputs, "no samples after an open that had failed"
        finally:
            peer.kill()

    def test_another_device_is_refused(self) -> None:
        if not self.wrong_identity:
            pytest.skip("wrong_identity is not given")
        with self.device() as peer:
            driver = self.make(peer, **self.wrong_identity)
            error = guarded(driver.open, "open")
            _close(driver, "close after a device was refused")
        assert isinstance(error, IdentityMismatch), f"open of the wrong device raised {error!r}, not IdentityMismatch"

    def test_opening_and_closing_move_nothing(self) -> None:
        with self.device() as peer:
            peer.writes()
            with Session(self.make(peer)) as session:
                time.sleep(0.05)
                assert not peer.writes(), "open wrote outputs; the first ones come by perform"
                session.receive(0.02)
            time.sleep(0.05)
            assert not peer.writes(), "close wrote outputs; the safe state is the worker's"


def _close(driver: BusDriver, doing: str) -> None:
    try:
        driver.close()
    except Exception as error:
        raise AssertionError(f"{doing} raised {type(error).__name__}: {error}; close never raises") from error


def _no_more(now: Held, before: Held) -> bool:
    return now.descriptors <= before.descriptors and now.threads <= before.threads
