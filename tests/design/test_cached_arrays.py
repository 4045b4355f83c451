"""What is computed once for the same matrices."""

import numpy as np
import pytest

from micromanip.control.cached_arrays import cached_arrays


def test_the_same_bits_are_computed_once_and_others_anew():
    asked = []

    @cached_arrays(2)
    def total(matrix, factor):
        asked.append(factor)
        if factor < 0.0:
            raise ValueError("negative")
        return factor * matrix.sum()

    one = np.arange(6.0).reshape(2, 3)
    assert total(one, 2.0) == total(one.copy(), 2.0) == 30.0
    assert asked == [2.0]
    one[0, 0] = np.nextafter(0.0, 1.0)  # the last bit of what was given before, in the same array
    assert total(one, 2.0) == 30.0
    assert total(one.reshape(3, 2), 2.0) == 30.0
    assert asked == [2.0] * 3
    for _ in range(2):
        with pytest.raises(ValueError, match="negative"):
            total(one, -1.0)
    assert asked[3:] == [-1.0, -1.0]
