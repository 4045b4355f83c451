"""What goes to the device: right, refused where it must be, and never old."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence

import pytest

from micromanip.bus.driver import Outcome
from micromanip.bus.errors import OutputRefused

from .hooks import Hooks, errors_text, settle
from .peer import Golden, Peer
from .session import TRIES, TURNS_AFTER_SILENCE, Session

_STORM, _STORM_S = 1000, 2.0
_ON_THE_WAY_S = 0.02


class WritingChecks(Hooks):
    """``perform`` with outputs."""

    def test_golden_outputs(self) -> None:
        if not self.golden_outputs:
            pytest.skip("golden_outputs are not given")
        for golden in self.golden_outputs:
            with self.running() as (peer, session):
                self.seen_as(peer, session, golden)

    def test_what_is_written_arrives(self) -> None:
        patterns = self.patterns()
        with self.running() as (peer, session):
            for values in (*patterns, *patterns):
                self.arrives(peer, session, values)

    def test_what_is_said_of_a_write_is_true(self) -> None:
        patterns = self.patterns()
        with self.running() as (peer, session):
            for values in (*patterns, *patterns):
                for task, description in enumerate(session.driver.tasks):
                    if description.outputs:
                        self.said_truly(peer, session, task, values)

    def test_what_is_read_back_is_what_was_written(self) -> None:
        old, new = self.patterns()
        with self.running() as (peer, session):
            for values in (old, new):
                self.arrives(peer, session, values)
                session.drain()
                session.driver.close()
                peer.writes()
                session.open()
                found = session.driver.read_outputs()
                assert not peer.writes(), "read_outputs wrote something: it must not move anything"
                assert len(found) == len(self.ordered(values)), (
                    f"read_outputs tells {len(found)} values, there are {len(self.ordered(values))} outputs"
                )
                wrong = [
                    f"{channel.name} reads {told:g}"
                    for channel, told, given in zip(session.driver.outputs, found, self.ordered(values), strict=True)
                    if told is not None and not self.equal(told, given)
                ]
                assert not wrong, f"{dict(values)} was written; {', '.join(wrong)}"

    def test_value_that_is_no_number_is_refused(self) -> None:
        self.refused([math.nan, math.inf, -math.inf])

    def test_value_beyond_the_wire_is_refused(self) -> None:
        self.refused(self.out_of_range)

    def test_latest_value_wins(self) -> None:
        old, new = self.patterns()
        with self.running() as (peer, session):
            peer.silence(True)
            end = time.monotonic() + _STORM_S
            for _ in range(_STORM):
                session.perform_all(self.ordered(old))
                session.receive(-1.0)
                if time.monotonic() > end or session.is_lost:
                    break
            peer.writes()
            peer.silence(False)
            session.values = self.ordered(new)
            seen: list[Mapping[str, float]] = []
            state: dict[str, float] = {}
            for _ in range(TURNS_AFTER_SILENCE):
                session.open_again_if_lost()
                session.run(1.0, lambda: self.reached(peer, state, new, seen))
            session.run(0.1)
            assert self.reached(peer, state, new, seen), f"{dict(new)} was given last; {state or 'nothing'} arrived"
            stale = [write for write in seen if any(self.equal(value, old[name]) for name, value in write.items())]
            assert len(stale) <= self.stale_writes, (
                f"{len(stale)} old writes arrived after a silence, before or after the newest; "
                f"at most {self.stale_writes}: nothing may be queued"
            )

    def seen_as(self, peer: Peer, session: Session, golden: Golden) -> None:
        """Write the values of `golden`: the device receives its units."""
        peer.received()
        raised = session.perform_all(self.ordered(golden.values))
        assert not raised, f"{dict(golden.values)} raised {errors_text(raised)}"
        seen: list[bytes] = []

        def complete() -> bool:
            seen.extend(peer.received())
            return set(golden.wire) <= set(seen)

        wanted = ", ".join(wire.hex() for wire in golden.wire)
        assert settle(complete), (
            f"{dict(golden.values)} must be {wanted} on the wire; seen: "
            f"{', '.join(wire.hex() for wire in seen) or 'nothing'}"
        )

    def arrives(self, peer: Peer, session: Session, values: Mapping[str, float]) -> None:
        """Write `values` once: the device has them."""
        peer.writes()
        raised = session.perform_all(self.ordered(values))
        assert not raised, f"{dict(values)} raised {errors_text(raised)}"
        state: dict[str, float] = {}
        assert settle(lambda: self.reached(peer, state, values)), (
            f"{dict(values)} was written; {state or 'nothing'} arrived"
        )

    def said_truly(self, peer: Peer, session: Session, task: int, values: Mapping[str, float]) -> None:
        """A task's outputs: what is held back does not arrive, what was sent is confirmed when the device has it.

        Where the driver tells that it waited for the device in vain, as it may on a busy machine, it is tried again.
        """
        for _ in range(TRIES):
            session.drain()
            session.confirmed.clear()
            peer.writes()
            raised = session.perform(task, self.ordered(values))
            assert raised is None, f"{dict(values)} raised {raised}"
            if session.outcome is not Outcome.SENT:
                break
            settle(lambda: session.receive(_ON_THE_WAY_S) is not None or task in session.confirmed)
            if task in session.confirmed:
                arrived = settle(lambda: bool(peer.writes()))
                assert arrived, f"{dict(values)} was confirmed by task {task}; nothing arrived"
                return
            assert session.errors, f"{dict(values)} was sent by task {task}, and never confirmed"
        assert session.outcome is not Outcome.SENT, (
            f"{dict(values)} was sent by task {task}, and not confirmed in {TRIES} tries: {errors_text(session.errors)}"
        )
        if session.outcome is Outcome.HELD:
            time.sleep(_ON_THE_WAY_S)
            assert not peer.writes(), f"task {task} said that {dict(values)} was held back, but something was sent"

    def refused(self, bad: Sequence[float]) -> None:
        """Each of the values `bad`, on each output: OutputRefused, and nothing arrives."""
        old, _ = self.patterns()
        with self.running() as (peer, session):
            driver = session.driver
            for task, description in enumerate(driver.tasks):
                for index in description.outputs:
                    for value in bad:
                        values = self.ordered(old)
                        values[index] = value
                        peer.writes()
                        error = session.perform(task, values)
                        name = driver.outputs[index].name
                        assert isinstance(error, OutputRefused), (
                            f"perform with {name} = {value:g} raised {error!r}, not OutputRefused"
                        )
                        time.sleep(0.005)
                        assert not peer.writes(), f"{name} = {value:g} was refused, but something was sent"
            raised = session.perform_all(self.ordered(old))
            assert not raised, f"after a value was refused, a good one raised {errors_text(raised)}"

    def reached(
        self,
        peer: Peer,
        state: dict[str, float],
        wanted: Mapping[str, float],
        seen: list[Mapping[str, float]] | None = None,
    ) -> bool:
        """Whether the writes up to now leave the outputs at `wanted`; kept in `state`, and in `seen`."""
        for write in peer.writes():
            state.update(write)
            if seen is not None:
                seen.append(write)
        return all(name in state and self.equal(state[name], value) for name, value in wanted.items())
