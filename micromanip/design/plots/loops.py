"""Bode and Nyquist plots of a loop, as data."""

from __future__ import annotations

import numpy as np

from ..loops import Margins, System, grid, refined
from ..report.model import Curve, Plot

_FAR, _HIGHEST = 3.0, 1e4
_MARKED_HZ = (5, 10, 20, 50, 100, 200, 500, 1000, 2000)


def loop_plots(name: str, loop: System, found: Margins) -> tuple[Plot, ...]:
    """Bode and Nyquist plot of an open loop."""
    omega, L = refined(
        loop.response, grid(loop.period_s, np.concatenate([loop.poles, np.linalg.eigvals(loop.closed())]))
    )
    # an oscillator in the controller is a pole on the unit circle: its peak would be all that one sees
    kept = (omega > 2 * np.pi) & (np.abs(L) < _HIGHEST)
    hertz, L = omega[kept] / (2 * np.pi), L[kept]
    near = np.abs(L) < _FAR
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 181))
    circle = found.modulus * turn - 1.0
    note = f"Gain margin {found.gain_dB:.1f} dB, phase margin {found.phase_deg:.0f} deg, Ms {found.sensitivity:.2f}."
    marked = [(each, int(np.argmin(np.abs(hertz - each)))) for each in _MARKED_HZ if hertz[0] < each < hertz[-1]]
    marked = [(each, k) for each, k in marked if near[k]]
    at = L[[k for _, k in marked]]
    nyquist = (
        Curve("L", np.where(near, L.real, np.nan), np.where(near, L.imag, np.nan)),
        Curve(f"Ms {found.sensitivity:.2f}: distance to -1", circle.real, circle.imag),
        Curve("Hz", at.real, at.imag, marks=True, texts=tuple(str(each) for each, _ in marked)),
        Curve("-1", np.array([-1.0]), np.array([0.0]), marks=True),
        Curve("unit circle", turn.real, turn.imag, faint=True),
    )
    phase = np.degrees(np.angle(L))
    phase[1:][np.abs(np.diff(phase)) > 180.0] = np.nan
    return (
        Plot(f"{name}: gain", "frequency, Hz", "|L|", (Curve("|L|", hertz, np.abs(L)),), note, log_x=True, log_y=True),
        Plot(
            f"{name}: phase",
            "frequency, Hz",
            "degrees",
            (Curve("L", hertz, phase),),
            log_x=True,
        ),
        Plot(f"{name}: Nyquist", "real part", "imaginary part", nyquist, note, equal=True),
    )
