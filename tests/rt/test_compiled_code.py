"""The compiled cycle allocates nothing and calls no Python: an allow-list of everything it can reach."""

import numba
import numpy as np
import pytest
from numba import types

from micromanip.rt.cell import cell_cycle
from micromanip.rt.cycle import run_virtual
from micromanip.rt.loop import run_loop
from micromanip.rt.records import CELL_PARAMETERS, CELL_STATE, MAX_OUTPUTS, MAX_SIGNALS, SIGNAL
from micromanip.rt.signatures import OUTPUTS, SAMPLES, SIGNALS
from micromanip.rt.telemetry import ROW, write_row

from .native import HARMLESS, llvm_of, llvm_that_runs, reach

pytestmark = pytest.mark.compiled_only

CELL, STATE = numba.from_dtype(CELL_PARAMETERS), numba.from_dtype(CELL_STATE)
# the real loop needs the clock and calls its drivers by address, and so does the virtual one
EXCHANGES = 1


def entry_signature(function):
    return function.signatures[0]


ENTRIES = {
    "run_loop": (run_loop, lambda: entry_signature(run_loop), EXCHANGES),
    "run_virtual": (run_virtual, lambda: entry_signature(run_virtual), EXCHANGES),
    "cell_cycle": (cell_cycle, lambda: (CELL, STATE, SIGNALS, OUTPUTS, SAMPLES, types.int64, types.int64), 0),
    "write_row": (
        write_row,
        lambda: (CELL, STATE, SIGNALS, numba.from_dtype(ROW), types.int64, types.int64, types.int64, types.int64),
        0,
    ),
}


@pytest.mark.long
@pytest.mark.xdist_group("what is reached")  # the laws are compiled once for all three
@pytest.mark.parametrize("name", ENTRIES)
def test_it_reaches_nothing_but_arithmetic(name):
    function, signature, by_address = ENTRIES[name]
    llvm = llvm_that_runs(function, signature())
    _inside, outside, indirect = reach(llvm, name)
    assert len(llvm.splitlines()) > 500  # the laws are inlined, and were looked into
    assert outside <= HARMLESS
    if not numba.config.BOUNDSCHECK:  # which has its exceptions to raise
        assert indirect <= 2 * by_address  # unrolled once


def allocates(n):
    return np.zeros(n).sum()


def allocates_in_a_callee(n):
    return numba.njit(allocates)(n) + 1.0


def grows(n):
    values = [0.0]
    for i in range(n):
        values.append(float(i))  # noqa: PERF401
    return values[-1]


def calls_python(n):
    with numba.objmode(x="float64"):
        x = float(np.random.default_rng(int(n)).random())
    return x + 1.0


def is_harmless(n):
    return np.sin(n) + n


@pytest.mark.filterwarnings("ignore:.*Code running in object mode")  # in colour, where colorama is installed
@pytest.mark.parametrize("function", [allocates, grows, calls_python])
def test_the_check_finds_what_does_not_belong(function):
    """Negative controls."""
    _, outside, _ = reach(llvm_of(function, (types.int64,)), function.__name__)
    assert outside - HARMLESS


def test_the_check_finds_an_allocation_deep_inside():
    inner = numba.njit(allocates)

    def deep(n):
        return inner(n) + 1.0

    _, outside, _ = reach(llvm_that_runs(numba.njit(deep), (types.int64,)), "deep")
    assert any("NRT_" in symbol for symbol in outside - HARMLESS)


def test_the_check_passes_plain_arithmetic():
    """Positive control."""
    _, outside, indirect = reach(llvm_of(is_harmless, (types.int64,)), "is_harmless")
    assert outside <= HARMLESS
    assert indirect == 0


def test_the_cycle_under_test_is_the_one_that_runs():
    """The types looked at above are those of the records that the loop hands over."""
    arguments = (
        np.zeros(1, CELL_PARAMETERS)[0],
        np.zeros(1, CELL_STATE)[0],
        np.zeros(MAX_SIGNALS, SIGNAL),
        np.zeros(MAX_OUTPUTS),
        np.zeros((1, 3)),
        0,
        0,
    )
    assert tuple(numba.typeof(argument) for argument in arguments) == ENTRIES["cell_cycle"][1]()
