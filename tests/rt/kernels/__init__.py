"""Loops over whole signals around the laws under test, compiled like them and with a cache of their own."""

from typing import Any

from micromanip.rt import vectors  # noqa: F401  (machine code of ``sums.py``)
from micromanip.rt.jit import Compiler
from micromanip.rt.laws.estimator import output, predict, predict_to, remember, start_estimator, update
from micromanip.rt.laws.excitation import excitation
from micromanip.rt.laws.feedforward import feedforward_voltage
from micromanip.rt.laws.hysteresis import inverse_plays, model_output, play, unshape
from micromanip.rt.laws.learned import add_learned
from micromanip.rt.laws.lqg import outer_setpoint
from micromanip.rt.laws.move import advance_move
from micromanip.rt.laws.network import network_output
from micromanip.rt.laws.pid import pid_output, unwind
from micromanip.rt.laws.reference import extrapolate, position, signal_reference, signal_sample
from micromanip.rt.laws.resonance import notch_output, without_resonances
from micromanip.rt.mailbox import bin_of, lower_edge
from micromanip.rt.sums import correct

compiled = Compiler(__file__)


@compiled
def play_course(x: Any, r: float, w: float, out: Any) -> float:
    """Play operator along `x` from state `w`; returns the last state."""
    for k in range(len(x)):
        w = play(x[k], r, w)
        out[k] = w
    return w


@compiled
def model_course(p: Any, w: Any, v: Any, out: Any) -> None:
    """Hysteresis model along the voltages `v`."""
    for k in range(len(v)):
        out[k] = model_output(p, w, v[k])


@compiled
def inverse_course(p: Any, z: Any, y: Any, out: Any) -> None:
    """Inverse model along the displacements `y`."""
    for k in range(len(y)):
        out[k] = unshape(p["shaping"], inverse_plays(p, z, y[k], 0.0))


@compiled
def network_course(p: Any, s: Any, y: Any, out: Any) -> None:
    """Recurrent network along the displacements `y`."""
    for k in range(len(y)):
        out[k] = network_output(p, s, y[k])


@compiled
def notch_course(p: Any, s: Any, x: Any, periods: Any, out: Any) -> None:
    """Notch along `x`, each sample so many cycles after the one before."""
    for k in range(len(x)):
        out[k] = notch_output(p, s, x[k], periods[k])


@compiled
def pid_course(p: Any, s: Any, error: Any, periods: int, out: Any) -> None:
    """PID along the errors, `periods` cycles apart."""
    for k in range(len(error)):
        out[k] = pid_output(p, s, error[k], periods)


@compiled
def saturated_course(
    p: Any, s: Any, reference: Any, gain: float, pole: float, low: float, high: float, out: Any
) -> None:
    """PID with back-calculation around a first-order plant whose input saturates; columns y, u, integrator."""
    y = 0.0
    for k in range(len(reference)):
        wanted = pid_output(p, s, reference[k] - y, 1)
        u = max(low, min(high, wanted))
        unwind(p, s, wanted - u)
        y = pole * y + (1.0 - pole) * gain * u
        out[k, 0], out[k, 1], out[k, 2] = y, u, s["integrator"]


@compiled
def estimator_course(p: Any, s: Any, cycles: Any, u: Any, y: Any, age: Any, out: Any, taken: Any) -> None:
    """Estimator stepped at `cycles`: prediction, a sample `age` cycles old where that is not negative, set-point."""
    for k in range(len(cycles)):
        predict_to(p, s, cycles[k])
        taken[k] = False
        if age[k] >= 0:
            taken[k] = update(p, s, cycles[k] - age[k], y[k])
        for i in range(p["states"]):
            out[k, i] = s["x"][i]
        remember(s, u[k])


@compiled
def tooth_course(p: Any, s: Any, y: Any, every: int, turns: Any, innovations: Any, out: Any) -> None:
    """Estimator with the set-point at rest and a sample `every` cycles; what it has found of the tooth by each."""
    for k in range(len(y)):
        predict_to(p, s, s["cycle"] + 1)
        if (k + 1) % every == 0:
            update(p, s, s["cycle"], y[k])
        turns[k], innovations[k] = s["turn"], s["innovation_um"]
        for i in range(p["states"]):
            out[k, i] = s["x"][i]
        remember(s, 0.0)


@compiled
def sums_course(p: Any, x: Any, scratch: Any, u: float, y: Any) -> None:
    """What a model's state shows, in `y`, and its next one, corrected by that; `scratch` is the same in the end."""
    y[0] = output(p, x)
    predict(p, x, scratch, u)
    correct(x, p["c"], y[0], scratch, x, p["states"])


@compiled
def outer_course(
    p: Any, s: Any, plant: Any, exogenous: Any, w: Any, moved: Any, still: Any, period_s: float, out: Any
) -> None:
    """Estimator and LQG around their own model (state `plant`, its disturbances last); column 0 y, 1 reference, 2 u.

    `w` is the reference's state, moved on by the parameters `moved` of its law, whose own state stands `still`.
    """
    start_estimator(p, s, 0, 0.0, output(p, plant))
    for k in range(len(out)):
        if k > 0:
            predict_to(p, s, k)
        y = output(p, plant)
        if k > 0:
            update(p, s, k, y)
        u = outer_setpoint(p, p["feedback"], p["reference"], s["x"], w)
        remember(s, u)
        out[k, 0], out[k, 1], out[k, 2] = y, position(w), u
        predict(p, plant, s["scratch"], u)
        extrapolate(moved, still["detuning"], w, period_s, exogenous)
        for i in range(len(w)):
            w[i] = exogenous[i]


@compiled
def bins_course(values: Any, bins: Any) -> None:
    """Histogram bin of each value."""
    for k in range(len(values)):
        bins[k] = bin_of(values[k])


@compiled
def edges_course(bins: Any, edges: Any) -> None:
    """Lower edge of each bin."""
    for k in range(len(bins)):
        edges[k] = lower_edge(bins[k])


@compiled
def excitation_course(p: Any, s: Any, cycle: Any, allowed: Any, out: Any) -> None:
    """The injected multisine over the numbers of the cycles."""
    for k in range(len(cycle)):
        out[k] = excitation(p, s, cycle[k], allowed[k])


@compiled
def learned_course(p: Any, s: Any, order: Any, samples: Any, cycle: Any, allowed: Any, out: Any) -> None:
    """What of a learned correction is added to position, velocity and acceleration, over the numbers of the cycles."""
    for k in range(len(cycle)):
        add_learned(p, s, order, out[k], samples, cycle[k], allowed[k])


@compiled
def move_course(p: Any, s: Any, steady: Any, out: Any) -> None:
    """Where a move has brought the axis, cycle by cycle."""
    total = 0.0
    for k in range(len(steady)):
        advance_move(p, s, k, steady[k])
        total += s["speed_um"]
        out[k] = total


@compiled
def feedforward_course(p: Any, s: Any, setpoint: Any, out: Any) -> None:
    """Voltages of the feedforward along the set-points."""
    for k in range(len(setpoint)):
        out[k] = feedforward_voltage(p, s, setpoint[k])


@compiled
def resonance_course(p: Any, s: Any, x: Any, out: Any) -> None:
    """Inverted resonances along `x`."""
    for k in range(len(x)):
        out[k] = without_resonances(p, s, x[k])


@compiled
def predictor_course(p: Any, s: Any, samples: Any, step_ns: int, after_ns: int, out: Any, detunings: Any) -> None:
    """Where the predictor sees the path `after_ns` after each sample, and what it found; NaN is no sample."""
    for k in range(len(samples)):
        now_ns = (k + 1) * step_ns
        signal_sample(p, s, samples[k], now_ns)
        signal_reference(p, s, now_ns + after_ns)
        out[k] = position(s["w"])
        for i in range(detunings.shape[1]):
            detunings[k, i] = s["detuning"][i]
