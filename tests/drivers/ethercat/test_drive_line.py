"""A drive on the line: enabled by permission alone, where it is; whatever takes it out of operation is told at once."""

from itertools import pairwise

import pytest

from micromanip.bus.ethercat.al_states import SAFEOP, WATCHDOG
from micromanip.emulation.ethercat import drive as there
from micromanip.rt.bus_image import DOWN
from tests.emulation.ethercat.wire import veth

from .bench import SILENT_CYCLES
from .drive_bench import SCALE, DriveBench, drive

pytestmark = [pytest.mark.live, pytest.mark.compiled_only, pytest.mark.xdist_group("ethercat")]
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, RESET = 0x06, 0x07, 0x0F, 0x02, 0x80


@pytest.fixture(scope="module")
def ends():
    with veth("ecv") as ends:
        yield ends


@pytest.fixture
def bench(ends):
    with DriveBench(ends) as bench:
        yield bench.open().follow()


def state(bench):
    return int(bench.line.drives[0]["state"])


def largest_step(values):
    return max((abs(b - a) for a, b in pairwise(values)), default=0.0)


def test_it_is_walked_to_Operation_enabled_by_permission_alone(bench):
    bench.until(lambda: bench.ok == 1.0, 0.0, 0.0, 0.0)
    assert set(bench.word_seen) == {0}, "nothing is switched on before"
    assert state(bench) == there.SWITCH_ON_DISABLED
    bench.enable()
    assert bench.word_seen == [0, SHUTDOWN, SWITCH_ON, ENABLE]
    assert state(bench) == there.ENABLED
    for wanted_V in (2.5, 7.5, 5.0):
        bench.exchange(wanted_V, 1.0, 0.0)
    bench.exchange(5.0, 1.0, 0.0)
    assert bench.out_V == pytest.approx(5.0)
    bench.until(lambda: state(bench) == there.SWITCH_ON_DISABLED, 5.0, 0.0, 0.0)
    assert bench.word_seen[-1] == 0
    assert bench.ok == 1.0, "it is as it is asked to be"


def test_enabled_where_it_is_found_it_goes_to_what_is_asked_for_no_faster_than_it_may(ends):
    with DriveBench(ends, rest_V=12.0) as bench:
        bench.open().follow()
        put_out = bench.enable()
        assert put_out[0] == pytest.approx(12.0)
        assert put_out[-1] == pytest.approx(0.0, abs=1.0)
        assert largest_step(put_out) <= 1.0 + SCALE
        assert len(set(put_out)) > 10


def test_a_position_that_no_target_can_be_is_not_enabled(ends, capfd):
    with DriveBench(ends, rest_V=160.0) as bench:
        bench.open().follow()
        said = []

        def is_told():
            said.append(capfd.readouterr().err)
            return bench.c["drive"][0]["revoked"] and "its position, 160, is outside" in "".join(said)

        bench.until(is_told, 0.0, 1.0, 0.0)
        assert ENABLE not in bench.word_seen
        assert bench.out_V == pytest.approx(160.0)
        bench.exchange(0.0, 1.0, 0.0)
        assert bench.ok == 0.0


@pytest.mark.parametrize(
    ("befalls", "leaves"),
    [
        ({"fault": 0x3210}, there.FAULT),
        ({"torque_off": 1}, there.SWITCH_ON_DISABLED),
        ({"stuck": 1}, None),
        ({"wrong_mode": 1}, None),
    ],
)
def test_what_takes_it_out_of_operation_is_told_in_that_cycle_and_it_never_comes_back_by_itself(bench, befalls, leaves):
    bench.enable(3.0)
    for field, value in befalls.items():
        bench.line.drives[0][field] = value
    bench.until(lambda: bench.ok == 0.0, 8.0, 1.0, 0.0)
    d = bench.c["drive"][0]
    assert d["losses"] == 1
    assert d["asked"] == 0, "the very frame that says so ends it"
    bench.exchange(8.0, 1.0, 0.0)
    assert bench.word_seen[-1] == 0
    if leaves is not None:
        bench.until(lambda: state(bench) == leaves, 8.0, 1.0, 0.0)
    for field in befalls:
        bench.line.drives[0][field] = 0
    bench.word_seen.clear()
    for _ in range(200):
        bench.exchange(8.0, 1.0, 0.0)
    assert bench.word_seen == [0], "neither enabled nor reset by itself"
    assert bench.ok == 0.0


def test_a_fault_is_reset_by_the_operator_alone_and_then_it_must_be_permitted_anew(bench):
    bench.enable()
    bench.line.drives[0]["fault"] = 0x8611
    bench.until(lambda: state(bench) == there.FAULT, 0.0, 1.0, 0.0)
    for _ in range(50):
        bench.exchange(0.0, 0.0, 0.0)
    assert (state(bench), bench.ok) == (there.FAULT, 0.0), "taking the permission back resets nothing"
    bench.until(lambda: bench.ok == 1.0, 0.0, 0.0, 1.0)
    assert bench.word_seen[-2:] == [RESET, 0]
    assert state(bench) == there.SWITCH_ON_DISABLED
    bench.enable()
    assert state(bench) == there.ENABLED


def test_a_reset_that_is_held_on_resets_no_later_fault(bench):
    bench.until(lambda: bench.ok == 1.0, 0.0, 0.0, 1.0)
    bench.line.drives[0]["fault"] = 0x8611
    bench.until(lambda: state(bench) == there.FAULT, 0.0, 0.0, 1.0)
    for _ in range(50):
        bench.exchange(0.0, 0.0, 1.0)
    assert state(bench) == there.FAULT
    assert RESET not in bench.word_seen


def test_one_that_refuses_is_given_up_and_told(bench, capfd):
    bench.line.drives[0]["refuses"] = 1
    bench.until(lambda: bench.c["drive"][0]["revoked"], 0.0, 1.0, 0.0)
    bench.line.drives[0]["refuses"] = 0
    said = []

    def is_told():
        said.append(capfd.readouterr().err)
        return "drive stage was not enabled within 100 ms: it refuses; it is in" in "".join(said)

    bench.until(is_told, 0.0, 1.0, 0.0)
    bench.until(lambda: state(bench) == there.SWITCH_ON_DISABLED, 0.0, 1.0, 0.0)
    assert bench.ok == 0.0
    bench.enable()


def test_a_quick_stop_holds_it_and_then_it_is_without_voltage(ends):
    with DriveBench(ends, keys=drive(stop="quick_stop")) as bench:
        bench.open().follow().enable(5.0)
        put_out = bench.until(lambda: state(bench) == there.SWITCH_ON_DISABLED, 5.0, 0.0, 0.0)
        assert QUICK_STOP in bench.word_seen
        assert put_out[0] == pytest.approx(5.0)
        assert largest_step(put_out) <= 1.0


@pytest.mark.parametrize("is_drop", [False, True])
def test_after_a_lost_line_it_is_at_rest_until_it_is_permitted_anew(bench, is_drop):
    bench.enable(4.0)
    if is_drop:
        with bench.lock:
            bench.line.applications[0].drop(WATCHDOG, SAFEOP)
    else:
        bench.meddle = lambda frame: []
        for _ in range(SILENT_CYCLES + 5):
            bench.exchange(4.0, 1.0, 0.0)
        bench.meddle = lambda frame: [frame]
    bench.until_code(DOWN, 4.0, 1.0, 0.0)
    del bench.word_seen[:-1]  # the last one that came before
    bench.until_code(0, 0.0, 1.0, 0.0)
    for _ in range(200):
        bench.exchange(0.0, 1.0, 0.0)
    assert bench.word_seen[1:] == [0], "the permission is an old one"
    assert bench.ok == 0.0
    bench.enable()
    assert state(bench) == there.ENABLED


def test_half_of_the_frames_lost_it_is_enabled_and_nothing_steps(bench):
    kept = iter([True, False] * 100_000)
    bench.meddle = lambda frame: [frame] if next(kept) else []
    put_out = bench.enable()
    for k in range(100):
        bench.exchange(0.2 * k, 1.0, 0.0)
        put_out.append(bench.out_V)
    assert largest_step(put_out) <= 5.0
    assert put_out[-1] > 10.0
