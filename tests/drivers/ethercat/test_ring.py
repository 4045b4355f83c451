"""A ring of three terminals that is cut at any place: no cycle is lost, nothing steps, and people are told."""

import time

import pytest
from micromanip_drivers.ethercat.link import LinkError

from micromanip.bus.ethercat.al_states import OP
from micromanip.bus.ethercat.registers import DC_DELAY
from micromanip.emulation.ethercat.controller import system_ns
from micromanip.emulation.ethercat.terminal import INPUTS
from micromanip.rt.bus_image import DOWN, TAKEN
from tests.emulation.ethercat.wire import until, veth

from .bench import AMPLIFIER, GAUGE, SILENT_CYCLES, Bench

pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]

SENSOR = {
    "vendor": 0x4D4D,
    "product": 0x30,
    "inputs": {"level": {"pdo": 0x1A00, "fields": {"level": {"index": 0x6000, "subindex": 1, "type": "int32"}}}},
}
TERMINALS = {"amplifier": AMPLIFIER, "gauge": GAUGE, "sensor": SENSOR}
PLACES = range(len(TERMINALS) + 1)


@pytest.fixture(scope="module")
def pairs():
    with veth("ecr") as near, veth("ecs") as far:
        yield near, far


@pytest.fixture
def bench(pairs):
    near, far = pairs
    with Bench(near, step_V=1.0, far_ends=far, terminals=TERMINALS) as bench:
        yield bench.open().follow()


def cut(bench, *places):
    with bench.lock:
        bench.line.cuts = set(places)
        bench.line.relink()


def level(bench, value):
    """Let the last terminal measure that."""
    bench.line.applications[2].memory[INPUTS : INPUTS + 4].view("<i4")[0] = value


@pytest.mark.parametrize("place", PLACES)
def test_a_cut_costs_no_cycle_and_no_sample(bench, place):
    bench.exchange(0.5, 0.0)
    bench.exchange(0.5, 0.0)
    before, sequence = bench.statistics, int(bench.sample("level")["sequence"])
    for number in range(40):
        cut(bench, *([place] if 10 <= number < 30 else []))
        bench.measure(strain=0.25 * number, count=number, deviation=0.0)
        level(bench, number)
        assert bench.exchange(0.5 + 0.1 * number, 0.0) == 0
        assert bench.voltage == pytest.approx(0.5 + 0.1 * number)
        if number > 0:
            assert bench.sample("level")["value"] == number - 1, "of the frame before, from whichever end"
            assert bench.sample("strain")["value"] == pytest.approx(0.25 * (number - 1))
        if number == 20:
            assert bench.statistics["cut_behind"] == place
    assert bench.sample("level")["sequence"] == sequence + 40
    after = bench.statistics
    grown = {name for name in after.keys() - {"bring_ups"} if after[name] != before.get(name, 0)}
    assert grown == {"received", "performed", "cuts"}, "nothing lost, late or wrong"
    assert after["cuts"] == before["cuts"] + 1


def test_people_are_told_where_it_is_cut_and_when_it_is_whole(bench, capfd):
    told = []

    def says(what):
        bench.exchange(0.0, 1.0)
        told.append(capfd.readouterr().err)
        return what in "".join(told)

    cut(bench, 1)
    assert until(lambda: says("the ring is cut between terminal amplifier and terminal gauge"))
    cut(bench, 3)
    assert until(lambda: says("is cut between terminal sensor and interface ecs"))
    cut(bench)
    assert until(lambda: says("the ring is whole again"))


def times(bench):
    """What each terminal's clock says at one moment, from the first one's (ns)."""
    now_ns = time.monotonic_ns()
    with bench.lock:
        first, *others = (int(system_ns(controller, now_ns)) for controller in bench.line.controllers)
    return [other - first for other in others]


def delays(bench):
    with bench.lock:
        return [a.memory[DC_DELAY : DC_DELAY + 4].view("<u4")[0] for a in bench.line.applications]


def drift(bench, terminal, ppm):
    with bench.lock:
        bench.line.applications[terminal].drift(ppm, time.monotonic_ns())


def agree(bench, *which):
    """Whether these clocks say the same, when they have been told the time once more."""
    bench.exchange(0.0, 1.0)
    there = [0, *times(bench)]
    return all(abs(there[k] - there[which[0]]) < 100 for k in which)


def test_the_ways_of_a_ring_are_measured_as_those_of_a_line(bench):
    """By its last terminal, which turns frames back for as long as that takes."""
    assert delays(bench) == [0, 750, 1500]
    assert (bench.c["ring"]["way_ns"], bench.c["turn_ns"]) == (1500, 1500)
    assert not bench.line.applications[2].is_closed
    assert until(lambda: agree(bench, 0, 1, 2))


def test_behind_a_cut_the_clocks_follow_the_first_of_them(bench, capfd):
    assert until(lambda: agree(bench, 0, 1, 2))
    drift(bench, 1, 900.0)
    cut(bench, 1)
    assert until(lambda: bench.exchange(0.0, 1.0) == 0 and delays(bench) == [0, 0, 750])

    def led():
        bench.exchange(0.0, 1.0)
        gauge_ns, sensor_ns = times(bench)
        return gauge_ns > 500_000 and abs(sensor_ns - gauge_ns) < 0.1 * gauge_ns

    assert until(led), "the first one of its half leads it"
    said = capfd.readouterr().err
    assert "the clocks behind the cut follow that of terminal gauge, which has no reference" in said
    assert times(bench)[0] < 10**9, "no frame has told them a time that is none"
    drift(bench, 1, 0.0)
    cut(bench)
    assert until(lambda: agree(bench, 0, 1, 2) and delays(bench) == [0, 750, 1500])


@pytest.mark.parametrize("place", PLACES)
def test_the_first_clock_is_heard_wherever_a_locked_ring_is_cut(pairs, place):
    near, far = pairs
    with Bench(near, far_ends=far, terminals=TERMINALS, lock={"within_us": 500.0}) as bench:
        bench.open()
        cut(bench, place)
        for _ in range(5):
            bench.exchange(0.0, 1.0)
        before, heard_ns = bench.statistics, int(bench.c["lock"]["told_ns"])
        for _ in range(3):
            bench.exchange(0.0, 1.0)
        assert bench.c["lock"]["told_ns"] > heard_ns
        assert bench.statistics["clock_leaps"] == before["clock_leaps"]


def test_two_cuts_lose_the_line_and_it_comes_back_at_rest(bench):
    bench.exchange(1.0, 0.0)
    cut(bench, 1, 2)
    codes = [bench.exchange(1.0, 0.0) for _ in range(SILENT_CYCLES + 5)]
    assert (codes[0], codes[-1]) == (0, DOWN)
    assert bench.statistics["wrong_working_counter"] >= SILENT_CYCLES
    cut(bench)
    bench.until_code(TAKEN, 1.0, 0.0)
    assert bench.voltage == 0.0
    bench.follow()


def test_a_terminal_that_leaves_OP_behind_the_cut_loses_the_line_at_once(bench):
    bench.exchange(1.0, 0.0)
    cut(bench, 1)
    bench.exchange(1.0, 0.0)
    with bench.lock:
        bench.line.applications[2].drop(0x1D)
    assert DOWN in [bench.exchange(1.0, 0.0) for _ in range(3)]


def test_a_loop_that_died_on_a_cut_ring_leaves_it_safe(bench):
    bench.exchange(1.0, 0.0)
    cut(bench, 1)
    assert bench.driver.safe_in_host()(bench.context) == 0
    assert OP not in {application.state for application in bench.line.applications}


def test_an_open_ring_is_not_brought_up(pairs):
    near, far = pairs
    with Bench(near, far_ends=far, terminals=TERMINALS) as bench:
        for place, where in ((0, "in front of the first slave"), (2, "behind slave 2")):
            cut(bench, place)
            with pytest.raises(LinkError, match=f"the ring is open {where}, 3 slaves answer: it is brought up whole"):
                bench.open()
