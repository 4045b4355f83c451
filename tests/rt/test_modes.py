"""The three modes in which the laws' tests run are really what they claim to be."""

import numba
import numpy as np
import pytest

from micromanip.rt.laws.hysteresis import play

from .kernels import play_course


def test_an_index_out_of_bounds_is_noticed():
    if not (numba.config.DISABLE_JIT or numba.config.BOUNDSCHECK):
        pytest.skip("compiled without bounds checks: that is the point")
    with pytest.raises(IndexError):
        play_course(np.zeros(5), 1.0, 0.0, np.zeros(3))


def test_compiled_or_not():
    assert hasattr(play, "py_func") != bool(numba.config.DISABLE_JIT)


@pytest.mark.compiled_only
def test_compiled_code_holds_the_rules():
    """No GIL, no exceptions, no fast-math."""
    options = play.targetoptions
    assert options["nogil"]
    assert options["error_model"] == "numpy"
    assert not options.get("fastmath", False)
