"""A record that every format is to give back: time, voltage and displacement of an actuator with a loop."""

import numpy as np

STEP_S, SAMPLES = 0.005, 600
T = STEP_S * np.arange(SAMPLES)
U = 50.0 + 40.0 * np.sin(2 * np.pi * 0.7 * T) + 3.0 * np.sin(2 * np.pi * 2.9 * T)
Y = 1.1 * U + 4.0 * np.sin(2 * np.pi * 0.7 * T - 0.8)


def lines(separator=",", decimal=".", digits=9):
    """Rows of a text."""
    rows = (separator.join(f"{value:.{digits}g}" for value in row) for row in zip(T, U, Y, strict=True))
    return [row.replace(".", decimal) if decimal != "." else row for row in rows]
