# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Recorded runs in Python
#
# What `micromanip report` and `compare` draw, by hand: a recording's error spectrum and hysteresis loop, its step
# response, and whether two runs differ. Each `# %%` is a cell: `jupytext --to notebook runs.py` makes a notebook of it,
# and editors run it as it is. Two runs of the simulated cell are recorded first, in virtual time; with recordings of
# your own leave that out.

# %%
import re
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from micromanip.design.recorded_run import RecordedRun
from micromanip.design.run_comparison import judged
from micromanip.design.run_figures import run_figures
from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

CONFIG = Path("config/simulated.yaml")
FOLDER = Path(tempfile.mkdtemp())
SECONDS = 8.0


# %%
def recorded(name: str, text: str) -> RecordedRun:
    """A run of the configuration `text`, from its arming on."""
    (FOLDER / f"{name}.yaml").write_text(text)
    prepared = prepare(FOLDER / f"{name}.yaml")
    configuration, source = prepared.configuration, prepared.source
    cell = VirtualCell(prepared.parameters, prepared.wiring, axes=list(configuration.axes))
    about = {"axes": list(configuration.axes), "period_ns": configuration.loop.period_ns}
    recording = McapRecording(
        {"file": str(FOLDER / f"{name}.mcap"), "configuration": source.text, "sha256": source.hash, **about}
    )
    recording.begin(cell.state[0])
    for rows in (cell.arm(), *(cell.run(1.0) for _ in range(round(SECONDS)))):
        recording.append(rows, prepared.parameters)
    recording.close()
    return RecordedRun(open_telemetry(FOLDER / f"{name}.mcap"))


before = recorded("before", CONFIG.read_text())
after = recorded("after", re.sub("control_weight: .*", "control_weight: 1000.0", CONFIG.read_text(), count=1))

# %% [markdown]
# ## Error spectrum
#
# In um per sqrt(Hz), while tracking. The outer loop of axis x was made slower in the second run.

# %%
figure, panel = plt.subplots()
for label, run in (("before", before), ("after", after)):
    spectra = run.axis["x"].spectra
    panel.loglog(spectra.frequency_Hz[1:], np.sqrt(spectra.density[1:]), label=label)
panel.set(title="Path error, axis x", xlabel="frequency, Hz", ylabel="um / sqrt(Hz)")
panel.legend()

# %% [markdown]
# ## Hysteresis loop
#
# The gauge over the voltage, as the path drove it.

# %%
figure, panel = plt.subplots()
telemetry = before.telemetry
panel.plot(telemetry.column("axis.0.voltage_V")[::20], telemetry.column("axis.0.strain_um")[::20], linewidth=0.5)
panel.set(title="Axis x", xlabel="voltage, V", ylabel="gauge, um")

# %% [markdown]
# ## Step response
#
# Deconvolved from what ran: there was no step.

# %%
step = before.axis["x"].steps.response()
figure, panel = plt.subplots()
panel.fill_between(1e3 * step.t_s, step.low, step.high, alpha=0.3)
panel.plot(1e3 * step.t_s, step.response)
panel.set(title="Strain loop, axis x", xlabel="time, ms", ylabel="gauge over set-point", xlim=(-1, 10))
print(f"rise {step.rise_ms[0]:.3f} ms, overshoot {step.overshoot_percent[0]:.1f} %, seen up to {step.reach_Hz:.0f} Hz")

# %% [markdown]
# ## Do they differ?
#
# Only axis x was changed: the others should show no difference, but for one in twenty by chance.

# %%
runs = [before, after]
differences = judged(runs, [run_figures(run) for run in runs])
for each in differences:
    if each.quantity == "error rms":
        print(f"{each.axis}: {each.a:.3f} um, then {each.b:.3f} um: {each.verdict}")
