"""Types of the compiled entry points' arguments: contiguous arrays of the records."""

from __future__ import annotations

import numba
import numpy as np
from numba import types

from .records import CELL_PARAMETERS, CELL_STATE, DRIVER, SIGNAL
from .telemetry import ROW


def array_of(dtype: np.dtype[np.void]) -> types.Array:
    """Contiguous one-dimensional array of `dtype`."""
    return types.Array(numba.from_dtype(dtype), 1, "C")


PARAMETERS = array_of(CELL_PARAMETERS)
STATES = array_of(CELL_STATE)
SIGNALS = array_of(SIGNAL)
OUTPUTS = types.float64[::1]
SAMPLES = types.float64[:, ::1]
DRIVERS = array_of(DRIVER)
ROWS = array_of(ROW)
WORDS = types.int64[::1]
