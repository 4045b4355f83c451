"""A driver at work: its load on the bus, its counters, its probe."""

from __future__ import annotations

import time
from collections.abc import Mapping

import pytest

from micromanip.bus.driver import Answer, BusDriver

from .hooks import Hooks, errors_text
from .peer import Peer
from .session import TRIES, Session

_RUN_S = 1.0
_LOAD_MARGIN = 0.1
_PROBE_S = 0.3


class RunningChecks(Hooks):
    """What it costs, and what it counts."""

    def test_load_is_at_most_what_is_declared(self) -> None:
        for _ in range(TRIES):
            with self.running() as (peer, session):
                session.run(0.1)
                peer.busy_s()
                begin = time.monotonic()
                session.run(_RUN_S)
                busy_s, took_s = peer.busy_s(), time.monotonic() - begin
            if took_s > 0.9 * _RUN_S:
                break
        assert took_s > 0.9 * _RUN_S, f"the link was lost after {took_s:.2f} s: {errors_text(session.errors)}"
        for load in session.driver.loads():
            assert busy_s.get(load.name, 0.0) > 0, f"the peer saw no use of {load.name}, which loads() declares"
            measured = busy_s[load.name] / took_s
            assert measured <= load.share * (1 + _LOAD_MARGIN), (
                f"{load.name} was used {100 * measured:.3g} % at worst-case lengths; "
                f"{100 * load.share:.3g} % is declared ({load.detail})"
            )

    def test_statistics_only_rise(self) -> None:
        with self.device() as peer:
            driver = self.make(peer)
            last = _statistics(driver, {})
            for _ in range(2):
                with Session(driver) as session:
                    last = _statistics(driver, last)
                    for _ in range(5):
                        session.run(0.02)
                        last = _statistics(driver, last)
                last = _statistics(driver, last)

    def test_probe_finds_the_device(self) -> None:
        with self.device() as peer:
            for _ in range(TRIES):
                driver = self.probing(peer)
                begin = time.monotonic()
                answers = list(driver.probe(_PROBE_S))
                driver.close()
                took_s = time.monotonic() - begin
                if answers and took_s < _PROBE_S + 1.0:
                    break
            assert answers, "probe found nothing, with the device there"
            strange = [answer for answer in answers if not isinstance(answer, Answer) or not answer.name]
            assert not strange, f"probe yields Answer objects with a name, not {strange[0]!r}"
            assert any(answer.is_value for answer in answers), "probe read no value, with the device there"
            assert took_s < _PROBE_S + 1.0 + self.patience_s, f"probe for {_PROBE_S} s took {took_s:.2f} s"

    def test_probe_writes_nothing(self) -> None:
        with self.device() as peer:
            peer.writes()
            driver = self.probing(peer)
            list(driver.probe(_PROBE_S))
            driver.close()
            time.sleep(0.02)
            assert not peer.writes(), "probe wrote outputs; it may only look"

    def probing(self, peer: Peer) -> BusDriver:
        """A driver that was not opened: probe does that itself."""
        if self.driver.probe is BusDriver.probe:
            pytest.skip("the driver has no probe")
        return self.make(peer)


def _statistics(driver: BusDriver, before: Mapping[str, int]) -> dict[str, int]:
    """The counters of `driver`, after a look at them."""
    now = dict(driver.statistics())
    strange = {name: value for name, value in now.items() if type(value) is not int}
    assert not strange, f"counters are whole numbers (int), not {strange}"
    for name, value in before.items():
        assert now.get(name, -1) >= value, f"the counter {name} fell from {value} to {now.get(name, 'nothing')}"
    return now
