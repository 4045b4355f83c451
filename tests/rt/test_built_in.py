"""What compiled code alone calls becomes machine code as a part of its caller, once, and works as in plain Python."""

import pytest
from numba import types
from numba.core.registry import cpu_target

from micromanip.rt.jit import Compiler, prepare

pytestmark = pytest.mark.compiled_only
compiled = Compiler(__file__)


@compiled
def innermost_step(x):
    return 3.0 * x


@compiled
def middle_step(x):
    return innermost_step(x) + innermost_step(x + 1.0)


@compiled.rare
def seldom_step(x, code):
    return x / code


@compiled.entry(types.float64(types.float64, types.int64))
def whole_step(x, times):
    for _ in range(times):
        x = middle_step(x) if x < 100.0 else seldom_step(x, 7)
    return x


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    """A cache of its own: what is loaded from one is not compiled here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        prepare(whole_step)
        yield


def symbols(name):
    """Functions of that name for which there is machine code."""
    engine = cpu_target.target_context.codegen()._engine
    return [symbol for symbol in engine._defined_symbols if name in symbol and "Env" not in symbol]


def test_the_result_is_that_of_plain_python():
    for times in range(8):
        x = 1.0
        for _ in range(times):
            x = 3.0 * x + 3.0 * (x + 1.0) if x < 100.0 else x / 7
        assert whole_step(1.0, times) == x


def test_a_part_has_no_machine_code_of_its_own():
    assert symbols("whole_step")
    assert not symbols("middle_step")
    assert not symbols("innermost_step")


def test_it_is_built_into_its_caller():
    (overload,) = whole_step.dispatcher.overloads.values()
    assert not [each.name for each in overload.library.get_defined_functions() if "middle_step" in each.name]
