"""The simulated cell called as the loop does: by the addresses of its four functions."""

import json

import numpy as np
from micromanip_drivers.simulated.driver import SimulatedCell
from micromanip_drivers.simulated.options import Options
from micromanip_drivers.simulated.records import CHANNELS, CONTEXT

from .called import Called

PERIOD_NS = 100_000

QUIET_PLANT = {
    "amplifier_noise_mV": 0.0,
    "strain_noise_nm": 0.0,
    "strain_hum_nm": 0.0,
    "stage_noise_nm": 0.0,
    "acceleration_noise": 0.0,
    "ambient_step_K": 0.0,
}
NO_FORCE = {"static_N": 0.0, "tooth_N": 0.0, "noise_N": 0.0}
STILL = {"amplitudes_um": [0.0, 0.0, 0.0], "joint_um": 0.0}
QUIET_TRACKER = {"noise_um": 0.0}


def quiet(**options):
    """Options of one axis without noise, force, deviation and coupling, but for what is given."""
    given = {
        "axes": ["x"],
        "coupling": 0.0,
        "plant": QUIET_PLANT,
        "force": NO_FORCE,
        "deviation": STILL,
        "tracker": QUIET_TRACKER,
    }
    return {**given, **options}


class Bench(Called):
    """An opened simulated cell, exchanged with by hand."""

    def __init__(self, options=None, *, opened=True):
        super().__init__(SimulatedCell(Options.model_validate_json(json.dumps(options or {})), PERIOD_NS))
        self.c = self.context.view(CONTEXT)[0]
        self.now_ns = 0
        if opened:
            assert self.call("open") == 0

    def exchange(self, *volts, periods=1):
        """One exchange; its return code."""
        if volts:
            self.outputs[:] = volts
        self.now_ns += periods * PERIOD_NS
        return self.exchange_at(self.now_ns, periods)

    def hold(self, cycles, *volts):
        """The same outputs for so many exchanges."""
        for _ in range(cycles):
            self.exchange(*volts)

    def signal(self, channel, axis="x"):
        return self.sample(f"{channel}_{axis}")

    def line(self, name):
        return float(self.sample(name)["value"])

    def record(self, cycles, *channels, volts=None):
        """Values (cycles, channels) of axis x; `volts` is a function of the cycle."""
        where = [CHANNELS.index(channel) for channel in channels]
        out = np.zeros((cycles, len(where)))
        for k in range(cycles):
            assert self.exchange(*([volts(k)] if volts else [])) == 0
            out[k] = self.signals["value"][where]
        return out
