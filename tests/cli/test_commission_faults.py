"""Broken cells: each is stopped before harm, with a sentence that names what is wrong on which axis, and what to do."""

import json
import re

import numpy as np
import pytest

from campaigns.report import CONFIG
from micromanip.cli import commission
from micromanip.design.commission import axis as steps
from micromanip.design.commission.axis import commission_axis
from micromanip.design.commission.guarded_experiment import GuardedExperiment
from micromanip.design.experiment import Ended
from micromanip.errors import CheckFailed
from micromanip.settings.check import prepare
from micromanip.virtual.experiment import VirtualExperiment

from .command import code_of

SHORT_S = 3.0
"""Of the major loop, which is long for its picture's sake."""


class Recorded:
    """An experiment that remembers the modes of all axes, and every voltage."""

    def __init__(self, prepared, *, process=False):
        self.experiment, self.modes, self.voltages = VirtualExperiment(prepared, process=process), [], []

    def __call__(self, configuration, seconds, samples=None, every=1):
        self.modes += [axis.mode for axis in configuration.axes.values()]
        rows = self.experiment(configuration, seconds, samples, every)
        self.voltages.append(rows["axis"]["voltage_V"][:, : len(configuration.axes)])
        return rows

    def path(self, configuration, axis):
        return self.experiment.path(configuration, axis)


def plant(figures):
    return "    variation: ", f"    plant: {{{figures}}}\n    variation: "


def fault(channel, kind, value=0.0):
    return (
        "    variation: ",
        f"    faults: [{{channel: {channel}, kind: {kind}, value: {value}, at_s: 0}}]\n    variation: ",
    )


def wired(signal, channel):
    return f"  {signal}: {{driver: cell,", f"  {signal}: {{driver: cell, channel: {channel},"


def cell(tmp_path, *changes, base="factory.yaml"):
    text = (CONFIG / base).read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    return file


BROKEN = {
    "dead gauge": ([fault("strain_x", "value")], "the strain gauge reads exactly 0 um all the time"),
    "dead stage sensor": ([fault("stage_x", "value")], "the stage sensor reads exactly 0 um while the actuator moves"),
    "flagged gauge": ([fault("strain_x", "status")], "the strain gauge gives no usable samples .* flagged as invalid"),
    "flagged stage sensor": ([fault("stage_x", "status")], "the stage sensor gave no usable sample .* flagged"),
    "gauge on its rail": ([fault("strain_x", "value", 180.0)], "reads exactly 180 um .* on its rail"),
    "stage sensor on its rail": ([fault("stage_x", "value", 300.0)], "reads exactly 300 um .* on its rail"),
    "gauge of noise": ([wired("strain_x", "acceleration_x")], "the actuator does not move, or the gauge does not see"),
    "stage sensor of noise": ([wired("stage_x", "acceleration_x")], "the stage sensor does not follow the actuator"),
    "clipped gauge": ([plant("strain_range_um: 60")], "the strain gauge .* or the gauge is at the end of its range"),
    "clipped stage sensor": ([plant("stage_zero_um: 50")], "the stage sensor is at an end of its range"),
    "hum of the gauge": ([plant("strain_hum_nm: 2000")], "rms, most of it at 50 Hz: hum or a vibration"),
    "stage sensor of much noise": ([plant("stage_noise_nm: 5000")], "the stage sensor moves by .* an open input"),
    "gauge of too little gain": ([fault("strain_x", "scale", 0.4)], "the record reaches .* % of the set-point's range"),
    "half an amplifier": ([plant("amplifier_range_V: [-20.0, 75.0]")], "the amplifier saturates there"),
    "inverted gauge": ([fault("strain_x", "scale", -1.0)], "the wrong way, feedback would run away"),
    "inverted stage sensor": ([fault("stage_x", "scale", -1.0)], "the path would be corrected the wrong way"),
    "slow amplifier": ([plant("amplifier_Hz: 8")], r"the gauge needs \d+ ms .*: an amplifier with too little current"),
    "low slew rate": ([plant("amplifier_slew_V_per_ms: 1")], r"the amplifier gives (0\.9\d?|1) V/ms, and .* says 40"),
    "weak amplifier": ([plant("amplifier_range_V: [-20.0, 60.0]")], "the amplifier saturates there"),
    "dead amplifier": ([plant("amplifier_range_V: [-0.001, 0.001]")], "the actuator does not move"),
    "little stroke": ([plant("reversible_um: [0.2, 0.0, 0.0]")], "the record reaches .* % of the set-point's range"),
    "swapped gauges": (
        [wired("strain_x", "strain_y"), wired("strain_y", "strain_x")],
        "that of axis y by .* the gauges or the outputs are swapped",
    ),
    "swapped stage sensors": (
        [wired("stage_x", "stage_y"), wired("stage_y", "stage_x")],
        "that of axis y .* the stage sensors or the outputs are swapped",
    ),
    "gauge in mm": ([fault("strain_x", "scale", 1e-3)], r"0.00\d+ um/V, far above its noise .* \(mm for um\?\)"),
    "stage sensor in mm": ([fault("stage_x", "scale", 1e-3)], r"0.05 to 50 of it: check scale and unit \(mm"),
    "loose flexure": ([plant("flexure_N_per_um: 0.05")], r"the stage swings at \d+ Hz, .*: a loose flexure or clamp"),
}  # fmt: skip


def refusal(config, tmp_path, monkeypatch, capsys):
    """What `commission` says on standard error; that it left open loop and the outputs' limits alone, and a report."""
    made = []
    monkeypatch.setattr(commission, "_virtual", lambda *args, **keys: made.append(Recorded(*args, **keys)) or made[-1])
    monkeypatch.setattr(steps, "TRIANGLE_S", SHORT_S)
    out = tmp_path / "out"
    assert code_of("commission", config, "--axis", "x", "--out", out, "--json") == 1
    said = capsys.readouterr()
    assert {mode for recorded in made for mode in recorded.modes} == {"voltage"}, "a loop was closed"
    output = prepare(config).configuration.outputs["voltage_x"]
    for voltages in (voltages for recorded in made for voltages in recorded.voltages):
        assert output.range_V[0] <= voltages.min()
        assert voltages.max() <= output.range_V[1]
        assert np.abs(np.diff(voltages, axis=0)).max() <= 0.1 * output.slew_V_per_ms + 1e-9
    document = json.loads(said.out)
    assert document["tuned"] is None
    assert not (out / "tuned.yaml").exists()
    assert "Commissioning stopped at the step" in (out / "report.html").read_text(encoding="utf-8")
    assert document["stopped"].startswith("axis x: ")
    assert f"{document['stopped'].removesuffix('.')}. What was found by then is in {out / 'report.html'}" in said.err
    assert "nothing is written" not in said.err
    return document["stopped"]


@pytest.mark.long  # half a second each
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_cell_is_named_before_a_loop_is_closed(name, tmp_path, monkeypatch, capsys):
    changes, wanted = BROKEN[name]
    said = refusal(cell(tmp_path, *changes), tmp_path, monkeypatch, capsys)
    assert re.search(wanted, said), said


def test_a_host_that_stood_still_is_told_as_that(tmp_path):
    """All sensors are silent at once, for 40 ms in the middle of a record whose gauge has a gap there."""

    class Stalled(Recorded):
        def __call__(self, configuration, seconds, samples=None, every=1):
            rows = super().__call__(configuration, seconds, samples, every)
            rows["axis"]["fresh"][1000:1400] = 0
            rows["axis"]["strain_um"][1000:1400] = np.nan
            return rows

    prepared = prepare(cell(tmp_path))
    with pytest.raises(CheckFailed) as refused:
        commission_axis(prepared.configuration, GuardedExperiment(Stalled(prepared)), "x", lambda _: None)
    assert "stood still meanwhile: no sensor said anything for 40 ms" in str(refused.value)


def test_a_device_that_stood_still_until_a_fault_came_is_told_as_that(tmp_path):
    """As a live experiment ends: by an error that has the rows, here silent from cycle 1000 on."""
    prepared = prepare(cell(tmp_path))
    rows = Recorded(prepared)(prepared.configuration, 0.3)
    rows["axis"]["fresh"][1000:] = 0

    def ended(*_):
        raise Ended("the experiment was ended by a fault: X-201", rows)

    watched = GuardedExperiment(ended)
    with pytest.raises(Ended):
        watched(prepared.configuration, 0.3)
    assert "no sensor said anything for 200 ms" in watched.stalled


def test_a_host_that_stood_still_once_is_told_at_the_end_of_all(tmp_path):
    prepared = prepare(cell(tmp_path))
    experiment = Recorded(prepared)
    watched, gaps = GuardedExperiment(experiment), iter((range(1000, 1400), range(0), range(1000, 1100)))

    def once_stalled(*given):
        rows = Recorded.__call__(experiment, *given)
        rows["axis"]["fresh"][next(gaps)] = 0
        return rows

    watched._experiment = once_stalled
    assert watched.ever_stalled == ""
    told = []
    for _ in range(3):
        watched(prepared.configuration, 0.3)
        told.append(re.findall(r"(\d+) ms", watched.stalled + watched.ever_stalled))
    assert told == [["40", "40"], ["40"], ["10", "40"]]


def test_a_fault_on_the_way_ends_it(tmp_path):
    class Faulty(Recorded):
        def __call__(self, configuration, seconds, samples=None, every=1):
            rows = super().__call__(configuration, seconds, samples, every)
            rows["fault"][-10:] = 4
            return rows

    prepared = prepare(cell(tmp_path))
    with pytest.raises(CheckFailed) as refused:
        commission_axis(prepared.configuration, GuardedExperiment(Faulty(prepared)), "x", lambda _: None)
    assert "the experiment was ended by fault X-201; nothing was tuned. Likely: " in str(refused.value)
    assert str(refused.value).startswith("axis x: sensors at rest: ")
