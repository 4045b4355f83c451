"""Whatever befalls frames and terminals: it is seen, no false value is taken, and no output steps."""

import math
import random
import time
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from micromanip_drivers.ethercat.link import LinkError

from micromanip.bus.errors import IdentityMismatch
from micromanip.bus.ethercat.al_states import INVALID_OUTPUTS, OP, SAFEOP
from micromanip.rt.bus_image import DOWN, TAKEN
from micromanip.rt.laws.sensor import SENSOR_STATE, read_signal
from tests.emulation.ethercat.wire import until, veth

from .bench import AMPLIFIER, GAUGE, SILENT_CYCLES, STILL_CYCLES, Bench

pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]


@pytest.fixture(scope="module")
def ends():
    with veth("ecd") as ends:
        yield ends


@pytest.fixture
def bench(ends):
    with Bench(ends) as bench:
        yield bench.open()


def test_the_line_is_brought_to_OP_and_the_outputs_follow(bench):
    assert bench.exchange(0.0, 1.0) == DOWN
    bench.follow()
    assert {application.state for application in bench.line.applications} == {OP}
    assert bench.line.applications[0].objects.read(0x8000, 1) == (513).to_bytes(2, "little")
    bench.exchange(12.5, 0.0)
    assert bench.voltage == pytest.approx(12.5)


def test_it_stays_at_rest_until_the_loop_asks_for_rest(bench):
    bench.until_code(TAKEN, 30.0, 0.0)
    for _ in range(20):
        assert bench.exchange(30.0, 0.0) == TAKEN
        assert bench.voltage == 0.0
    bench.follow()


def test_a_lost_frame_is_counted_and_nothing_steps(ends):
    with Bench(ends, step_V=1.0) as bench:
        bench.open().follow()
        chance, wanted, given = random.Random(1), 0.0, [0.0]
        bench.meddle = lambda frame: [frame] if chance.random() < 0.5 else []
        for _ in range(300):
            wanted += chance.uniform(-1, 1)
            bench.exchange(max(0.0, min(100.0, wanted)), 0.0)
            given.append(float(bench.voltage))
        assert bench.statistics["lost"] > 50
        assert max(abs(b - a) for a, b in pairwise(given)) <= 1.0 + 1e-4
        assert max(given) > 3.0, "it did move"


def test_all_frames_lost_end_at_rest_and_come_back_there(bench):
    bench.follow()
    bench.exchange(20.0, 0.0)
    bench.meddle = lambda frame: []
    codes = [bench.exchange(20.0, 0.0) for _ in range(SILENT_CYCLES + 5)]
    assert codes[0] == 0
    assert codes[-1] == DOWN
    sent = bench.came
    for _ in range(STILL_CYCLES - 10):
        assert bench.exchange(20.0, 0.0) == DOWN
    assert bench.came == sent, "nothing is sent while the slaves come to rest"
    bench.meddle = lambda frame: [frame]
    bench.until_code(TAKEN, 20.0, 0.0)
    assert bench.voltage == 0.0
    bench.follow()
    assert bench.statistics["losses"] == 1


def test_each_frame_is_told_as_what_became_of_it(bench):
    """Injected, counted and told: used, superseded, lost, with a wrong working counter, doubled, delayed, damaged."""
    bench.follow()
    for _ in range(2):
        bench.exchange(0.0, 1.0)
    chance, befell, held, superseded = random.Random(2), Counter(), [], 0
    wrong_at = int(bench.c["working_counter_at"])

    def befall(frame):
        nonlocal superseded
        fate = chance.choice(["used"] * 8 + ["dropped", "doubled", "delayed", "wrong", "damaged"])
        befell[fate] += 1
        back = [held.pop()] if held else []
        usable = len(back)
        if fate == "delayed":
            held.append(frame)
        elif fate == "wrong":
            back.append(bytes([*frame[:wrong_at], frame[wrong_at] ^ 1, *frame[wrong_at + 1 :]]))
        elif fate == "damaged":
            back.append(bytes([*frame[:17], frame[17] ^ 1, *frame[18:]]))
        elif fate != "dropped":
            back += [frame] * (2 if fate == "doubled" else 1)
            usable += 1
        superseded += max(0, usable - 1)
        return back

    sensor = np.zeros(1, SENSOR_STATE)[0]

    def cycles(count):
        for _ in range(count):
            assert bench.exchange(5.0, 0.0) == 0
            read_signal(bench.sample("strain"), sensor, bench.now_ns, 10**12, (-1e9, 1e9), math.inf)

    def told():
        s, counts = sensor, bench.statistics
        missing = int(bench.driver.missing(bench.context)[bench.driver.inputs.index("strain")])
        return Counter(
            all=int(s["samples"] + s["refused"] + s["unseen"]), lost=missing, superseded=int(s["unseen"]) - missing,
            **{k: counts[k] for k in ("doubled", "delayed", "wrong_working_counter", "not_this_frame")},
            never_back=counts["lost"], late=counts["late"],
        )  # fmt: skip

    cycles(2)
    before = told()
    bench.meddle = befall
    cycles(500)
    superseded += len(held)  # it comes with the next one
    bench.meddle = lambda frame: [held.pop(), frame] if held else [frame]
    cycles(2)
    after = told()
    after.subtract(before)
    assert min(befell.values()) > 10
    assert after == Counter(
        all=502, lost=befell["dropped"] + befell["damaged"] + befell["wrong"], superseded=superseded,
        doubled=befell["doubled"], delayed=befell["delayed"], wrong_working_counter=befell["wrong"],
        not_this_frame=befell["damaged"], never_back=befell["dropped"] + befell["damaged"], late=0,
    )  # fmt: skip


def test_a_late_frame_is_no_sample_and_no_acknowledgement_of_the_next(bench):
    bench.follow()
    held = []

    def late(frame):
        held.append(frame)
        return [held.pop(0)] if len(held) > 3 else []

    bench.meddle = late
    for _ in range(30):
        assert bench.exchange(5.0, 0.0) == 0
    assert bench.c["gate"]["sent_count"] - bench.c["gate"]["acknowledged"] >= 3
    assert bench.statistics["losses"] == 0


def test_a_terminal_that_takes_no_part_loses_the_line_by_its_working_counter(bench):
    bench.follow()
    bench.exchange(20.0, 0.0)
    with bench.lock:
        bench.line.applications[1].be_absent()
    codes = [bench.exchange(20.0, 0.0) for _ in range(SILENT_CYCLES + 5)]
    assert (codes[0], codes[-1]) == (0, DOWN)
    assert bench.statistics["wrong_working_counter"] >= SILENT_CYCLES


def test_a_terminal_that_leaves_OP_loses_the_line_at_once_and_comes_back_at_rest(bench):
    bench.follow()
    bench.exchange(20.0, 0.0)
    with bench.lock:
        bench.line.applications[0].drop(INVALID_OUTPUTS, SAFEOP)
    assert DOWN in [bench.exchange(20.0, 0.0) for _ in range(3)]
    bench.until_code(TAKEN, 20.0, 0.0)
    assert bench.voltage == 0.0
    assert until(lambda: bench.statistics["bring_ups"] == 2)
    bench.follow()


def test_a_terminal_that_was_without_power_is_set_up_anew_and_at_rest(bench):
    bench.follow()
    bench.exchange(20.0, 0.0)
    with bench.lock:
        bench.line.applications[0].switch_on(bench.now_ns)
        bench.line.relink()
    bench.until_code(TAKEN, 20.0, 0.0)
    assert bench.voltage == 0.0
    assert bench.line.applications[0].objects.read(0x8000, 1) == (513).to_bytes(2, "little")


def test_terminals_that_changed_places_stay_at_rest(bench, capfd):
    bench.follow()
    bench.exchange(20.0, 0.0)
    with bench.lock:
        bench.line.swap(0, bench.now_ns)
    said = []

    def is_told():
        said.append(capfd.readouterr().err)
        return bench.exchange(20.0, 0.0) == DOWN and "the order has changed" in "".join(said)

    assert until(is_told)
    assert bench.exchange(20.0, 0.0) == DOWN
    with bench.lock:
        bench.line.swap(0, bench.now_ns)
    bench.until_code(TAKEN, 20.0, 0.0)


def test_a_wrong_line_is_refused_at_the_start(ends):
    with (
        Bench(ends, slaves={"amplifier": terminal(AMPLIFIER, serial=8), "gauge": terminal(GAUGE)}) as bench,
        pytest.raises(IdentityMismatch, match="terminal amplifier, has serial 0x8 instead of 0x7"),
    ):
        bench.open()
    with (
        Bench(ends, slaves={"amplifier": terminal(AMPLIFIER)}) as bench,
        pytest.raises(LinkError, match="1 slaves answer, but 2 terminals are configured"),
    ):
        bench.open()


def test_a_mapping_that_the_terminal_does_not_have_is_told(ends):
    fields = {"strain": {"index": 0x6003, "subindex": 1, "type": "int32"}}
    gauge = GAUGE | {"inputs": {"strain": {"pdo": 0x1A00, "fields": fields}}}
    slaves = {"amplifier": terminal(AMPLIFIER), "gauge": terminal(GAUGE)}
    with (
        Bench(ends, slaves=slaves, terminals={"amplifier": AMPLIFIER, "gauge": gauge}) as bench,
        pytest.raises(IdentityMismatch, match=r"0x60030120.*Object cannot be mapped to the PDO"),
    ):
        bench.open()


def test_a_loop_that_died_leaves_a_line_that_is_seen_to_be_safe(bench):
    bench.follow()
    bench.exchange(20.0, 0.0)
    assert bench.driver.safe_in_host()(bench.context) == 0
    assert OP not in {application.state for application in bench.line.applications}
    bench.line.controllers["powered"] = 0
    assert bench.driver.safe_in_host()(bench.context) != 0


def terminal(keys, **changes):
    from micromanip_drivers.ethercat.options import Terminal

    return Terminal.model_validate(keys | changes)


def test_a_loop_that_waits_has_the_samples_of_its_own_cycle(ends):
    with Bench(ends, wait_us=70.0) as bench:
        bench.open()
        bench.c["wait_ns"] = 10_000_000_000  # the slaves are a thread of this process
        bench.now_ns = time.monotonic_ns()
        bench.follow()
        with bench.lock:
            bench.measure(strain=2.5, count=1, deviation=0.0)
        bench.exchange(0.0, 1.0)
        assert bench.sample("strain")["value"] == pytest.approx(2.5)
        assert bench.c["gate"]["acknowledged"] == bench.c["gate"]["sent_count"]
