"""What comes from the device: in time, right, whole, and with what was lost counted."""

from __future__ import annotations

import time
from collections.abc import Sequence

import pytest

from micromanip.bus.driver import BusDriver
from micromanip.bus.errors import LinkError, TransientError

from .hooks import Hooks, errors_text
from .peer import Golden, Peer
from .session import Session


class ReadingChecks(Hooks):
    """``receive``, and the answers that ``perform`` takes."""

    def test_samples_come(self) -> None:
        with self.running() as (_, session):
            if not session.inputs:
                pytest.skip("the driver has no inputs")
            came = session.fresh()
            missing = ", ".join(sorted(set(session.inputs) - session.good()))
            assert came, f"no good sample within 1 s of {missing}; errors: {errors_text(session.errors)}"

    def test_receive_keeps_its_deadline_under_a_silent_device(self) -> None:
        with self.running() as (peer, session):
            peer.silence(True)
            for ahead_s in (0.02, 0.0, -1.0, 0.02, 0.0, -1.0):
                begin = time.monotonic()
                error = session.receive(ahead_s)
                late_s = time.monotonic() - begin - max(0.0, ahead_s)
                assert late_s < self.patience_s, f"receive returned {late_s:.2f} s after until_ns ({ahead_s:g} s ahead)"
                if isinstance(error, LinkError):
                    break

    def test_perform_does_not_block_under_a_silent_device(self) -> None:
        with self.running() as (peer, session):
            peer.silence(True)
            for task in range(len(session.driver.tasks)):
                begin = time.monotonic()
                session.perform(task)
                took_s = time.monotonic() - begin
                assert took_s < self.patience_s, f"perform of task {task} blocked for {took_s:.2f} s"

    def test_receive_returns_soon_after_the_first(self) -> None:
        with self.running() as (_, session):
            if type(session.driver).receive is BusDriver.receive:
                pytest.skip("the device speaks only when it is asked")
            begin = time.monotonic()
            session.receive(1.5)
            took_s = time.monotonic() - begin
            if not session.arrivals:
                pytest.skip("the device said nothing by itself for 1.5 s")
            assert took_s < 0.5 + self.patience_s, f"receive went on for {took_s:.2f} s with samples there"

    def test_golden_inputs(self) -> None:
        if not self.golden_inputs:
            pytest.skip("golden_inputs are not given")
        with self.running() as (peer, session):
            for golden in self.golden_inputs:
                peer.silence(True)
                session.drain()
                self.understood(peer, session, golden)
                peer.silence(False)
                session.fresh()

    def test_garbage_gives_no_sample(self) -> None:
        self.disturbed(self.garbage(), "garbage")

    def test_partial_frames_give_no_sample(self) -> None:
        if not self.partial():
            pytest.skip("there is nothing to cut: golden_inputs are not given, and partial is not overridden")
        self.disturbed(self.partial(), "partial frames")

    def test_gaps_of_the_counter_are_lost_samples(self) -> None:
        with self.running() as (peer, session):
            assert session.fresh(), f"no samples to begin with; errors: {errors_text(session.errors)}"
            session.forget()
            for count in (1, 5):
                self.skipped(peer, session, count)

    def test_wrap_of_the_counter_is_no_gap(self) -> None:
        with self.running() as (peer, session):
            if peer.counter_range is None:
                pytest.skip("the peer has no counter_range")
            assert session.fresh(), f"no samples to begin with; errors: {errors_text(session.errors)}"
            for _ in range(3):  # the wrap is in one of them; a wider gap could be a late one from the past
                self.skipped(peer, session, peer.counter_range // 2 - 2)

    def test_time_stamps(self) -> None:
        begin_ns = time.monotonic_ns()
        with self.running() as (_, session):
            session.run(0.2)
            arrivals = list(session.arrivals)
        if not session.inputs:
            pytest.skip("the driver has no inputs")
        assert arrivals, "no samples came"
        for one in arrivals:
            name = session.inputs[one.sample.channel]
            since_s = (one.sample.time_ns - begin_ns) * 1e-9
            assert since_s >= 0, f"a sample of {name} is {-since_s:.6g} s older than the test: not CLOCK_MONOTONIC?"
            ahead_s = (one.sample.time_ns - one.handed_ns) * 1e-9
            assert ahead_s <= 0, f"a sample of {name} was taken {ahead_s:.6g} s after it came: not CLOCK_MONOTONIC?"

    def values_of(self, session: Session, name: str) -> list[float]:
        """Values of the good samples of an input."""
        index = session.inputs.index(name)
        return [one.sample.value for one in session.arrivals if one.sample.channel == index and not one.sample.status]

    def understood(self, peer: Peer, session: Session, golden: Golden) -> None:
        """Let the silent device say `golden`: its values come of it."""
        for wire in golden.wire:
            peer.send(wire)
        session.run(0.5, lambda: session.good() >= set(golden.values))
        hexadecimal = " ".join(wire.hex() for wire in golden.wire)
        for name, wanted in golden.values.items():
            values = self.values_of(session, name)
            assert values, f"{hexadecimal} gave no good sample of {name}; errors: {errors_text(session.errors)}"
            assert self.equal(values[-1], wanted), f"{hexadecimal} is read as {name} {values[-1]}, not {wanted}"

    def disturbed(self, wires: Sequence[bytes], what: str) -> None:
        """Put `wires` between good frames: no wrong value comes of it, and nothing worse than a TransientError."""
        with self.device() as peer:
            wanted = {name: value for golden in self.golden_inputs for name, value in golden.values.items()}
            for name, value in wanted.items():
                peer.set_input(name, value)
            with Session(self.make(peer)) as session:
                assert session.fresh(), f"no samples to begin with; errors: {errors_text(session.errors)}"
                for wire in wires:
                    peer.send(wire)
                    session.run(0.004)
                worse = [error for error in session.errors if not isinstance(error, TransientError)]
                assert not worse, f"{what} raised more than a TransientError: {errors_text(worse)}"
                for name, value in wanted.items():
                    wrong = [found for found in self.values_of(session, name) if not self.equal(found, value)]
                    assert not wrong, f"{what} gave {len(wrong)} samples of {name} as {wrong[:3]}; it was {value}"
                assert session.fresh(20.0), f"no samples in 20 s after {what}; errors: {errors_text(session.errors)}"

    def skipped(self, peer: Peer, session: Session, count: int) -> None:
        """Let the device leave out `count` readings: so many are lost on every input, no more and no less."""
        session.forget()
        peer.skip(count)

        def lost() -> list[int]:
            lost = [0] * len(session.inputs)
            for one in session.arrivals:
                lost[one.sample.channel] += one.sample.lost
            return lost

        session.run(1.0, lambda: min(lost()) >= count)
        session.run(0.05)
        for name, number in zip(session.inputs, lost(), strict=True):
            assert number == count, f"{count} samples of {name} were left out; {number} are counted as lost"
