"""A move of a held axis: on its course, without a jump at its ends, at rest soon after a stop, and never by itself."""

import numpy as np
import pytest

from micromanip.control.moves import Move
from micromanip.rt.laws.move import MOVE_PARAMETERS, MOVE_STATE

from .builders import record
from .kernels import move_course

WAYS = Move(((3.0, 200, 100), (-5.0, 400, 50), (0.0, 300, 100)), 1150, 80)
SINE = Move((), 2000, 80, 2.0, 300, 0.005, 0.005)
SWEEP = Move((), 3000, 80, 0.5, 300, 0.002, 0.02)
ALL = pytest.mark.parametrize("move", [WAYS, SINE, SWEEP], ids=["ways", "sine", "sweep"])


def played(move, cycles, s=None, stop=False, number=1, steady=None):
    p = record(MOVE_PARAMETERS)
    move.fill(p, number, stop=stop)
    if s is None:
        s = record(MOVE_STATE)
    out = np.zeros(cycles)
    move_course(p, s, np.ones(cycles, bool) if steady is None else steady, out)
    return out, s


@ALL
def test_it_ends_where_it_began_and_stays(move):
    out, s = played(move, move.cycles + 300)
    assert s["over"] == 1
    assert np.abs(out[move.cycles :]).max() < 1e-9
    assert np.abs(np.diff(out, prepend=0.0)).max() <= move.fastest * 1.0001
    assert np.abs(np.diff(out, 2)).max() <= 0.2 * move.fastest, "no step of the speed"
    assert np.abs(out).max() >= 0.95 * max(move.amplitude_um, *(abs(um) for um, _, _ in move.places or [(0, 0, 0)]))


def test_places_are_rested_at():
    out, _ = played(WAYS, WAYS.cycles)
    assert out[200:299] == pytest.approx(3.0, abs=1e-9)
    assert out[700:749] == pytest.approx(-5.0, abs=1e-9)


def test_a_sine_is_one_and_a_sweep_goes_from_one_frequency_to_the_other():
    k = 1.0 + np.arange(SINE.cycles)
    middle = slice(400, 1600)
    out, _ = played(SINE, SINE.cycles)
    assert out[middle] == pytest.approx(2.0 * np.sin(2 * np.pi * 0.005 * k)[middle], abs=1e-9)
    out, _ = played(SWEEP, SWEEP.cycles)
    crossings = np.flatnonzero(np.diff(np.sign(out[5:-5])))
    assert np.diff(crossings)[1] == pytest.approx(0.5 / 0.004, rel=0.3)
    assert np.diff(crossings)[-2] == pytest.approx(0.5 / 0.02, rel=0.05)


@ALL
@pytest.mark.parametrize("at", [50, 310, 777])
def test_a_stop_brings_it_to_rest_on_its_course(move, at):
    before, s = played(move, at)
    after, s = played(move, 400, s, stop=True)
    whole = before[-1] + after
    assert np.abs(np.diff(whole, prepend=before[-1])).max() <= move.fastest * 1.0001
    assert (whole[move.stop_cycles + 1 :] == whole[-1]).all()
    assert s["over"] == 1
    reference, _ = played(move, at + move.stop_cycles)
    assert reference[at - 1 :].min() - 1e-9 <= whole[-1] <= reference[at - 1 :].max() + 1e-9


@ALL
def test_what_ends_the_hold_ends_it_where_it_is_and_for_good(move):
    before, s = played(move, 400)
    played(move, 1, s, steady=np.zeros(1, bool))
    assert s["over"] == 1
    assert not played(move, 500, s)[0].any()
    assert s["offset_um"] == pytest.approx(before[-1])
    assert played(move, 300, s, number=2)[0].any(), "the next one is another"


@ALL
def test_what_is_looked_at_beforehand_is_as_far_as_it_goes(move):
    out, _ = played(move, move.cycles)
    seen = move.looked_at()
    assert seen.min() == pytest.approx(out.min(), abs=0.02 * np.ptp(out))
    assert seen.max() == pytest.approx(out.max(), abs=0.02 * np.ptp(out))
    assert seen.min() <= out.min() + 0.01
    assert seen.max() >= out.max() - 0.01
