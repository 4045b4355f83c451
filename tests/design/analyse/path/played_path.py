"""What is predicted of the reach of a drawn path, beside the same path played in virtual time.

A path is a slow sine and a joint's oscillation on each axis, amplitude and speed drawn. Where the preview says that it
fits, no limit may hold while it is played. Where it does not, a limit must hold in the first stretch that it names.
"""

from dataclasses import replace

import numpy as np

from micromanip.design.analyse.path.preview import RANGE, TRACKER, VOLTAGE, preview_of
from micromanip.recordings.path_deviation import read_path_deviation
from micromanip.rt.states import TRACKING
from micromanip.virtual.experiment import VirtualExperiment, at_limit, with_options

RESERVE_UM, TOLERANCE_UM = 3.0, 5.0
SECONDS, RATE_HZ, START_S = 4.0, 500.0, 4.0
NARROW_V = (10.0, 125.0)
"""There the voltage ends before the set-point does."""
SLOW_UM, SLOW_HZ, JOINT_UM, JOINT_HZ = (80.0, 330.0), (0.2, 1.0), (0.0, 30.0), (6.0, 14.0)
ABOUT_S = 0.05
"""Around a stretch: noise meets a limit a little earlier."""


def drawn(seed):
    """Deviation (n, 3) in um of the path of `seed`, `RATE_HZ` rows a second, from rest."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    begun = np.clip(2.0 * time_s, 0.0, 1.0)
    columns = []
    for _ in range(3):
        slow_um, slow_hz, joint_um, joint_hz = (rng.uniform(*each) for each in (SLOW_UM, SLOW_HZ, JOINT_UM, JOINT_HZ))
        slow = slow_um * np.sin(2.0 * np.pi * slow_hz * time_s + rng.uniform(0.0, 2.0 * np.pi))
        columns.append(begun**2 * (3.0 - 2.0 * begun) * (slow + joint_um * np.sin(2.0 * np.pi * joint_hz * time_s)))
    return np.column_stack(columns)


def narrowed(prepared):
    """The cell with `NARROW_V` as its voltages, parked at the lower one."""
    configuration = prepared.configuration
    limits = {"range_V": NARROW_V, "park_V": NARROW_V[0]}
    outputs = {name: output.model_copy(update=limits) for name, output in configuration.outputs.items()}
    return replace(prepared, configuration=configuration.model_copy(update={"outputs": outputs}))


def first_met_s(prepared, path, seed):
    """Moments on `path` at which a limit holds, a tracker's sample is out of range, or the cell does not track."""
    configuration, options = prepared.configuration, prepared.wiring.options["cell"]
    deviation = options.deviation.model_copy(update={"file": str(path.file), "start_s": START_S})
    options = options.model_copy(update={"deviation": deviation, "seed": seed})
    cell = VirtualExperiment(with_options(prepared, "cell", options)).cell(configuration, prepared.samples)
    cell.run(START_S - len(cell.arm()) * configuration.loop.period_ns * 1e-9)
    rows = cell.run(SECONDS)
    low_um, high_um = configuration.reference.range_um
    deviation_um = rows["axis"]["deviation_um"][:, : len(configuration.axes)]
    over = (deviation_um <= low_um) | (deviation_um >= high_um)
    for i, axis in enumerate(configuration.axes):
        own = rows["axis"][:, i]
        over[:, i] |= at_limit(configuration, axis, own["voltage_V"], own["setpoint_um"])
    return np.flatnonzero((rows["state"] != TRACKING) | over.any(axis=1)) * configuration.loop.period_ns * 1e-9


def hard_stretches(cell, seed, folder):
    """Where the preview of the path of `seed` says that a limit holds, in their order; and `first_met_s`."""
    file, columns = folder / f"path{seed}.csv", drawn(seed)
    time_s = np.arange(len(columns)) / RATE_HZ
    header = ",".join(["t_s", *(f"deviation_{axis}_um" for axis in "xyz")])
    np.savetxt(file, np.column_stack([time_s, columns]), delimiter=",", header=header, comments="", fmt="%.6f")
    path = read_path_deviation(file, "xyz")
    found = preview_of(cell, path, RESERVE_UM, TOLERANCE_UM)
    over = sorted((each for axis in found.axes for each in axis.stretches), key=lambda each: each.from_s)
    return over, [each for each in over if each.what in (TRACKER, RANGE, VOLTAGE)], first_met_s(cell, path, seed + 1)
