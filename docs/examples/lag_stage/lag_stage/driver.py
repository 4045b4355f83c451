"""A cyclic driver compiled by numba: an actuator that follows its voltage with a lag, and its strain gauge."""

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from micromanip.driver import Compiler, CyclicDriver, Functions, entries

CONTEXT = np.dtype([("um_per_V", "f8"), ("share", "f8"), ("voltage_V", "f8"), ("position_um", "f8")], align=True)

compiled = Compiler(__file__)


@compiled
def follow(c):
    """Move for one period."""
    c["position_um"] += c["share"] * (c["um_per_V"] * c["voltage_V"] - c["position_um"])


@compiled
def exchange(c, outputs, inputs, now_ns, periods):
    """Move for the periods that passed, leave a fresh sample, take the new voltage."""
    strain = inputs[0]
    for _ in range(periods):
        follow(c)
    strain["value"], strain["time_ns"], strain["status"] = c["position_um"], now_ns, 0
    strain["sequence"] += 1
    c["voltage_V"] = outputs[0]
    return 0


@compiled
def safe(c):
    """Take the voltage away; as open and as close it does no harm either."""
    c["voltage_V"] = 0.0
    return 0


ENTRIES = entries(compiled, CONTEXT, safe, exchange, safe, safe)


class LagOptions(BaseModel):
    """Keys of this driver in the configuration."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    um_per_V: float = Field(default=0.9, gt=0, description="Displacement at rest.")
    lag_ms: float = Field(default=0.5, gt=0, description="Time constant.")


class LagStage(CyclicDriver):
    """One axis, one actuator, one gauge."""

    Options = LagOptions
    simulated = True
    inputs = ("strain",)
    outputs = ("voltage",)

    def __init__(self, options, period_ns):
        self.options, self.period_ns = options, period_ns

    def context(self):
        context = np.zeros(1, CONTEXT)
        context["um_per_V"] = self.options.um_per_V
        context["share"] = -np.expm1(-self.period_ns * 1e-6 / self.options.lag_ms)
        return context.view(np.uint8)

    def functions(self):
        return Functions(*ENTRIES.addresses)
