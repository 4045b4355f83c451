"""The switch by which an amplifier forgets its fault: the operator's `reset`, at rest, and nothing else."""

from micromanip.rt.faults import cell_fault
from micromanip.rt.states import ARM, DRIVER_ERROR, FAULT, NO_FAULT, READY, RESET, STOP

from .bench_cell import BenchCell, parameters

PLACE, CYCLES = 7, 10


def cell(wired=True):
    record = parameters()
    record[0]["amplifier_reset"], record[0]["reset_cycles"] = PLACE if wired else -1, CYCLES
    bench = BenchCell(record)
    bench.run(5)
    assert bench.outputs[PLACE] == 0.0, "nothing is reset at the start"
    return bench


def on_for(bench, cycles=3 * CYCLES):
    """In how many of the next cycles the switch is on."""
    found = 0
    for _ in range(cycles):
        bench.step()
        found += bench.outputs[PLACE] == 1.0
    return found


def test_a_fault_that_is_reset_resets_the_amplifier_for_a_while():
    bench = cell()
    cell_fault(bench.p, bench.s, DRIVER_ERROR, True, 1.0, 0.0)
    assert on_for(bench, 4 * CYCLES) == 0, "not by itself"
    assert bench.s["state"] == FAULT
    assert bench.step(RESET)
    assert (bench.s["state"], bench.s["fault"], bench.outputs[PLACE]) == (READY, NO_FAULT, 1.0)
    assert on_for(bench) == CYCLES - 1


def test_in_READY_it_is_accepted_where_the_switch_is_wired_and_moves_nothing():
    bench = cell()
    parked = bench.voltages
    assert bench.step(RESET)
    assert bench.s["state"] == READY
    assert 1 + on_for(bench) == CYCLES
    assert bench.voltages == parked
    assert not cell(wired=False).step(RESET)


def test_arming_ends_it_and_no_other_state_knows_it():
    bench = cell()
    bench.step(RESET)
    assert bench.step(ARM)
    assert bench.outputs[PLACE] == 0.0
    assert not bench.step(RESET)
    assert on_for(bench) == 0
    bench.step(STOP)
    assert not bench.step(RESET)


def test_not_while_the_outputs_are_away():
    bench = cell()
    bench.s["outputs_away"] = 1
    assert not bench.step(RESET)
    assert bench.outputs[PLACE] == 0.0
