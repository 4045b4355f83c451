"""Another class of hysteresis: Bouc-Wen, asymmetric by its square and its rates, with a part that lags the voltage.

``w = linear v + square v^2 - z``, ``dz = (fall - (with_sign sgn(dv z) + without_sign) |z|) dv``, and a share of `w`
follows through a first-order lag: the faster, the wider the loop. Wen, J. Eng. Mech. Div. 102 (1976).
"""

from __future__ import annotations

from typing import Any

from .compiled import compiled


@compiled
def bouc_wen_step(p: Any, s: Any, v: float) -> float:
    """Free displacement (um) at `v` (V), a sub-step after the one before."""
    change, z = v - s["input_V"], s["internal_um"]
    same = 1.0 if change * z >= 0.0 else -1.0
    z += (p["fall"] - (p["with_sign"] * same + p["without_sign"]) * abs(z)) * change
    s["input_V"], s["internal_um"] = v, z
    whole = p["linear"] * v + p["square"] * v * v - z
    s["lagging_um"] += p["lag_step"] * (whole - s["lagging_um"])
    return (1.0 - p["lag_share"]) * whole + p["lag_share"] * s["lagging_um"]
