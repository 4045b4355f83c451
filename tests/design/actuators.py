"""An actuator as its model in the configuration has it: what fits and inverses are held against."""

import numpy as np

from micromanip.rt.jit import Compiler
from micromanip.rt.laws.feedforward import HYSTERESIS_PARAMETERS, MAX_CREEP
from micromanip.rt.laws.hysteresis import MAX_PLAYS, play, shape
from micromanip.settings.compile.hysteresis import fill_hysteresis

compiled = Compiler(__file__, allocates=True)


@compiled
def _respond(p, v, y):
    w = np.zeros(MAX_PLAYS)
    creep = np.zeros(MAX_CREEP)
    before = shape(p["shaping"], v[0])
    creep[:] = before
    for k in range(len(v)):
        u = shape(p["shaping"], v[k])
        widening = p["rate_cycles"] * abs(u - before)
        before = u
        total = p["alpha"] * u
        for i in range(p["plays"]):
            w[i] = play(u, p["r"][i] + widening, w[i])
            total += p["rho"][i] * w[i]
        for m in range(p["creeps"]):
            total += p["creep_gain"][m] * creep[m]
            creep[m] += p["creep_step"][m] * (u - creep[m])
        y[k] = total


def predict(model, voltage_V, step_s=1e-3):
    """Displacement (n,) in um of `model` over `voltage_V` (n,) sampled at `step_s`; plays start as (3).

    The sampling matters for creep and rate dependence only.
    """
    record, y = np.zeros(1, HYSTERESIS_PARAMETERS), np.empty(len(voltage_V))
    fill_hysteresis(record[0], model, step_s)
    _respond(record[0], np.ascontiguousarray(voltage_V, dtype=float), y)
    return y
