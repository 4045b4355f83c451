"""The section ``actuator`` of an axis from its identified dynamics: what the feedforward of mode strain can undo.

By the model P (voltage to gauge) a sine r is followed, with the PID C, the inverse F of what is undone, the gauge's lag
g and the preview v, as

    position / r = e^(jw(v + g)) P (F + C e^(-jw(v + g))) / (1 + C P)

P is divided by its gain, which the inverse hysteresis takes away. The delay, resonances, then the amplifier's lag are
undone if the error is smaller for it over plants whose mode is up to 3 % off and half or one and a half times as damped
as identified, and no larger on the worst of them: what does not bear that is left alone.
What the PID has left to do is then so little that less of it may be better: its share is the one with the least of
noise and of what the hysteresis model leaves over, at the frequencies that are asked for, of those that the loop bears:
with less gain the crossover may come down to a mode of the stage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from micromanip.control.pid import pid_response
from micromanip.control.system import Array, Complex, System, delay
from micromanip.design.analyse.loops import Perturbation, antiresonance, damped, perturbed
from micromanip.rt.laws.resonance import MAX_RESONANCES
from micromanip.settings.schema.actuator import Actuator, Resonance
from micromanip.settings.schema.axis import Inner

FREQUENCIES_HZ = (1.0, 5.0, 10.0, 20.0, 50.0, 100.0, 150.0)
"""Of the sines by which it is judged."""
OFF, DAMPED = (0.97, 1.0, 1.03), (0.5, 1.0, 1.5)
"""Factors on a mode's frequency and its damping."""
_BAND_HZ = (20.0, 200.0)
"""Where the delay is read: below, creep and hysteresis turn the phase."""
_HIGHEST_HZ, _LIGHTLY, _LAG_HZ = 1000.0, 0.3, (200.0, 3000.0)
_WORTH = 0.95
"""What the error over the plants must fall to for one more thing to be undone."""
_SHARES = (100.0, 90.0, 80.0, 70.0, 60.0)


@dataclass(frozen=True)
class InvertedActuator:
    """The section, and the errors of sines (share of their amplitude, rms over ``FREQUENCIES_HZ``) that decided.

    `tried` has rms and worst over the plants for what was tried, in that order; `taken` is what was taken of it.
    """

    actuator: Actuator
    tried: dict[str, tuple[float, float]]
    taken: tuple[str, ...]

    @property
    def last(self) -> str:
        """Of what was tried, that which the section holds."""
        return self.taken[-1] if self.taken else "nothing"


def invert_actuator(
    dynamics: System,
    delay_cycles: int,
    inner: Inner,
    gauge_us: float,
    noise_um: float,
    left_um: float,
    asked_Hz: Sequence[float],
    bears: Callable[[float], bool] = lambda _: True,
) -> InvertedActuator:
    """What to undo of `dynamics` (V to um), behind so many cycles, under the PID `inner`.

    `gauge_us`: how late the gauge is, by its data sheet; `noise_um`: its noise, rms; `left_um`: what the hysteresis
    model leaves over, rms, at `asked_Hz`; `bears`: whether the loop keeps its margins with a share of the PID's
    gain.
    """
    late = delay(delay_cycles, dynamics.period_s)
    system = late.then(dynamics)
    plants = [late.then(_moved(dynamics, *factors)) for factors in product(OFF, DAMPED)]
    additions: dict[str, dict[str, Any]] = {
        "delay": {},
        "resonances": {"resonances": resonances(dynamics)},
        "lag": {"lag_us": lag(dynamics)},
    }

    def errors(section: Actuator) -> tuple[float, float]:
        each = np.array([_error(plant, system, inner, section) for plant in plants])
        return float(np.sqrt(np.mean(each**2))), float(each.max())

    chosen, taken = Actuator(gauge_us=gauge_us), []
    tried = {"nothing": errors(chosen)}
    rms, worst = tried["nothing"]
    for name, addition in additions.items():
        timed = with_delay(system, chosen.model_copy(update=addition))
        tried[name] = errors(timed)
        if tried[name][0] < _WORTH * rms and tried[name][1] <= worst:
            chosen, (rms, worst) = timed, tried[name]
            taken.append(name)
    shares = [percent for percent in _SHARES if percent == _SHARES[0] or bears(0.01 * percent)]
    share = min(shares, key=_cost(system, inner, noise_um, left_um, asked_Hz))
    return InvertedActuator(chosen.model_copy(update={"feedback_percent": share}), tried, tuple(taken))


def resonances(system: System) -> tuple[Resonance, ...]:
    """The lightly damped modes below 1 kHz with an antiresonance beside them, the slowest first."""
    pairs: list[Resonance] = []
    for pole in sorted(system.poles[system.poles.imag > 1e-9], key=abs, reverse=True):
        frequency, damping = damped(pole, system.period_s)
        zero = antiresonance(system, complex(pole))
        if zero is None or damping > _LIGHTLY or frequency > _HIGHEST_HZ:
            continue
        beside, its_damping = damped(zero, system.period_s)
        pairs.append(
            Resonance(
                resonance_Hz=float(f"{frequency:.5g}"),
                resonance_damping=float(f"{damping:.4g}"),
                antiresonance_Hz=float(f"{beside:.5g}"),
                antiresonance_damping=float(f"{its_damping:.4g}"),
            )
        )
    return tuple(sorted(pairs, key=lambda pair: pair.resonance_Hz)[:MAX_RESONANCES])


def lag(system: System) -> float | None:
    """Time constant (us) of the slowest first-order lag between 200 Hz and 3 kHz; None where there is none."""
    real = system.poles[(np.abs(system.poles.imag) < 1e-9) & (system.poles.real > 0.0)].real
    rates_Hz = -np.log(real) / (2 * np.pi * system.period_s)
    between = rates_Hz[(rates_Hz > _LAG_HZ[0]) & (rates_Hz < _LAG_HZ[1])]
    return float(f"{1e6 / (2 * np.pi * between.min()):.4g}") if len(between) else None


def with_delay(system: System, section: Actuator) -> Actuator:
    """`section` with the delay that is left in `system` once the rest of it is undone, and its gauge apart."""
    omega = 2 * np.pi * np.linspace(*_BAND_HZ, 60)
    phase = np.unwrap(np.angle(system.response(omega) * _inverse(section, omega, system.period_s)))
    late_us = -1e6 * float(omega @ phase / (omega @ omega)) - section.gauge_us
    return section.model_copy(update={"delay_us": float(f"{max(late_us, 0.0):.4g}")})


def _inverse(section: Actuator, omega: Array, period_s: float) -> Complex:
    """What the feedforward makes of a set-point before its static gain: response (n,) of ``rt/laws/feedforward.py``."""
    s, F = 1j * omega, np.ones(len(omega), complex)
    for each in section.resonances:
        p, z = 2 * np.pi * each.resonance_Hz, 2 * np.pi * each.antiresonance_Hz
        F *= (z / p) ** 2 * (s * s + 2 * each.resonance_damping * p * s + p * p)
        F /= s * s + 2 * each.antiresonance_damping * z * s + z * z
    if section.lag_us is not None:
        F *= 1.0 + (1.0 - np.exp(-s * period_s)) / np.expm1(period_s / (1e-6 * section.lag_us))
    return F


def _error(plant: System, nominal: System, inner: Inner, section: Actuator) -> float:
    """Error of the position, rms over the sines as a share of their amplitudes, on `plant`."""
    omega, T = 2 * np.pi * np.array(FREQUENCIES_HZ), nominal.period_s
    P, C = plant.response(omega), pid_response(inner, T, omega)
    gauge = np.exp(1e-6j * omega * section.gauge_us)
    ahead = np.exp(1e-6j * omega * section.delay_us)
    followed = gauge * ahead * P * (_inverse(section, omega, T) / _gain(nominal, section) + C / (gauge * ahead))
    return float(np.sqrt(np.mean(np.abs(1.0 - followed / (1.0 + C * P)) ** 2)))


def _gain(system: System, section: Actuator) -> float:
    """Gain (um/V) of `system` without what the section undoes, over the band."""
    omega = 2 * np.pi * np.linspace(*_BAND_HZ, 60)
    return float(np.mean(np.abs(system.response(omega) * _inverse(section, omega, system.period_s))))


def _moved(system: System, frequency: float, damping: float) -> System:
    return perturbed(system, Perturbation(stiffness=frequency**2, damping=damping))


def _cost(
    system: System, inner: Inner, noise_um: float, left_um: float, asked_Hz: Sequence[float]
) -> Callable[[float], float]:
    """Noise passed on and hysteresis left over (um^2) by percent of the PID's gain."""
    T = system.period_s
    even, asked = np.linspace(0.0, np.pi / T, 501)[1:], 2 * np.pi * np.array(asked_Hz)

    def cost(percent: float) -> float:
        L, low = (0.01 * percent * pid_response(inner, T, w) * system.response(w) for w in (even, asked))
        noise = noise_um**2 * np.mean(np.abs(L / (1.0 + L)) ** 2)
        return float(noise + left_um**2 * np.mean(1.0 / np.abs(1.0 + low) ** 2))

    return cost
