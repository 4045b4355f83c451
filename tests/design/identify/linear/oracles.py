"""Models of others, from a recording (n, inputs), (n, outputs): an autoregression, and N4SID by `nfoursid`."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import dlsim


@dataclass(frozen=True)
class Oracle:
    """``x+ = A x + B u``, ``y = C x + D u`` about the means of what it was found from."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    mean_u: np.ndarray

    def fit_percent(self, u, y):
        """Mean over the outputs of 100 less the free run's error, state and offset at its start fitted."""
        if np.abs(np.linalg.eigvals(self.A)).max() > 1.0 + 1e-6:
            return -np.inf
        run = dlsim((self.A, self.B, self.C, self.D, 1.0), u - self.mean_u)[1]
        free, power = np.empty((len(u), *self.C.shape)), self.C
        for k in range(len(u)):
            free[k], power = power, power @ self.A
        offsets = np.repeat(np.eye(y.shape[1])[:, None], len(u), axis=1)
        table = np.concatenate([np.hstack([free[:, o], offsets[o]]) for o in range(y.shape[1])])
        error = (y - run).T.ravel()
        left = (error - table @ np.linalg.lstsq(table, error, rcond=None)[0]).reshape(y.shape[1], -1)
        return 100.0 - 100.0 * np.mean(np.sqrt(np.mean(left**2, axis=1)) / y.std(axis=0))


def arx(u, y, order):
    """``y[k] = sum a_i y[k-i] + sum b_i u[k-i] + c`` by least squares, i from 1 and for inputs from 0."""
    late = [y[order - i : len(y) - i] for i in range(1, order + 1)]
    driven = [u[order - i : len(u) - i] - u.mean(axis=0) for i in range(order + 1)]
    table = np.hstack([*late, *driven, np.ones((len(y) - order, 1))])
    found = np.linalg.lstsq(table, y[order:], rcond=None)[0][:-1].T
    outputs, inputs = y.shape[1], u.shape[1]
    a = found[:, : order * outputs].reshape(outputs, order, outputs).transpose(1, 0, 2)
    b = found[:, order * outputs :].reshape(outputs, order + 1, inputs).transpose(1, 0, 2)
    A = np.eye(order * outputs, k=outputs)
    A[:, :outputs] = a.reshape(-1, outputs)
    B = (b[1:] + a @ b[0]).reshape(-1, inputs)
    return Oracle(A, B, np.eye(outputs, order * outputs), b[0], u.mean(axis=0))


def n4sid(u, y, order, rows=16):
    """Of `rows` block rows."""
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    driven, seen = ([f"{name}{k}" for k in range(each.shape[1])] for name, each in (("u", u), ("y", y)))
    frame = pd.DataFrame(np.hstack([u - u.mean(axis=0), y - y.mean(axis=0)]), columns=[*driven, *seen])
    method = NFourSID(frame, seen, driven, num_block_rows=rows)
    method.subspace_identification()
    found, _ = method.system_identification(rank=order)
    return Oracle(found.a, found.b, found.c, found.d, u.mean(axis=0))
