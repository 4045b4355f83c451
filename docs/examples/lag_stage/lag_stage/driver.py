"""A cyclic driver compiled by numba: an actuator that follows its voltage with a lag, and its strain gauge."""

import numba
import numpy as np
from numba import types
from pydantic import BaseModel, ConfigDict, Field

from micromanip.driver import CONTEXT_SIGNATURE, EXCHANGE_SIGNATURE, SIGNAL, Compiler, CyclicDriver, Functions

CONTEXT = np.dtype([("um_per_V", "f8"), ("share", "f8"), ("voltage_V", "f8"), ("position_um", "f8")], align=True)
CONTEXT_POINTER = types.CPointer(numba.from_dtype(CONTEXT))
SIGNAL_POINTER = types.CPointer(numba.from_dtype(SIGNAL))

compiled = Compiler(__file__)


@compiled
def follow(c):
    """Move for one period."""
    c["position_um"] += c["share"] * (c["um_per_V"] * c["voltage_V"] - c["position_um"])


@compiled.c_function(
    EXCHANGE_SIGNATURE.return_type(
        CONTEXT_POINTER, types.CPointer(types.float64), SIGNAL_POINTER, types.int64, types.int64
    )
)
def exchange(context, outputs, inputs, now_ns, periods):
    """Move for the periods that passed, leave a fresh sample, take the new voltage."""
    c, strain = numba.carray(context, 1)[0], numba.carray(inputs, 1)[0]
    for _ in range(periods):
        follow(c)
    strain["value"], strain["time_ns"], strain["status"] = c["position_um"], now_ns, 0
    strain["sequence"] += 1
    c["voltage_V"] = numba.carray(outputs, 1)[0]
    return 0


@compiled.c_function(CONTEXT_SIGNATURE.return_type(CONTEXT_POINTER))
def safe(context):
    """Take the voltage away; as open and as close it does no harm either."""
    numba.carray(context, 1)[0]["voltage_V"] = 0.0
    return 0


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
        return Functions(open=safe.address, exchange=exchange.address, safe=safe.address, close=safe.address)
