"""Systems that are written down here, and records of them."""

import numpy as np
from scipy.linalg import block_diag


def pole(hertz, damping, dt):
    """Discrete pole of a damped mode."""
    omega = 2 * np.pi * hertz
    return np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * omega * dt)


def system(seed=0, inputs=2, outputs=3):
    """Two modes, a lag and no direct term, in coordinates that tell nothing: A, B, C, D."""
    rng = np.random.default_rng(seed)
    first, second = pole(40.0, 0.05, 1e-3), pole(120.0, 0.1, 1e-3)
    A = block_diag(*([[p.real, -p.imag], [p.imag, p.real]] for p in (first, second)), [[0.8]])
    B, C = rng.normal(size=(5, inputs)), rng.normal(size=(outputs, 5))
    T = rng.normal(size=(5, 5)) + 3 * np.eye(5)
    return np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, np.zeros((outputs, inputs))


def response(A, B, C, D, u, x0=None, process=None, sensor=None):
    """Output (n, l), step by step, with noise (n, states) and (n, l) where given."""
    x = np.zeros(len(A)) if x0 is None else np.array(x0, dtype=float)
    y = np.zeros((len(u), len(C)))
    for k in range(len(u)):
        y[k] = C @ x + D @ u[k] + (0.0 if sensor is None else sensor[k])
        x = A @ x + B @ u[k] + (0.0 if process is None else process[k])
    return y


def transfer(A, B, C, D, z):
    """Transfer matrix (f, l, m)."""
    return np.array([C @ np.linalg.solve(point * np.eye(len(A)) - A, B) + D for point in z])


def circle(count=40):
    """Points on the upper half of the unit circle."""
    return np.exp(1j * np.linspace(0.01, 3.1, count))


def sorted_poles(poles):
    return np.asarray(poles)[np.lexsort((np.imag(poles), np.round(np.real(poles), 5)))]
