"""The tool's first contact is no disagreement of the sensors, on any make of cell; a sensor that is off is."""

import re

import numpy as np
import pytest
from micromanip_drivers.simulated.options import Plant

from campaigns.report import CONFIG
from micromanip.design.commission.axis import commission_axis
from micromanip.design.commission.closing import Options
from micromanip.rt.states import DISAGREEMENT, NO_FAULT, TRACKING
from micromanip.settings.check import prepare
from micromanip.settings.checks.ranges import range_warnings
from micromanip.settings.compile.cell import compile_cell
from micromanip.virtual.cell import VirtualCell
from micromanip.virtual.experiment import VirtualExperiment, with_options

SIMULATED = CONFIG / "simulated.yaml"
LOW_UM, SECONDS = 46.0, 5.0
"""Axis x of a weaker actuator; its path is out of reach for seconds on end."""


@pytest.fixture(scope="module")
def weak(tmp_path_factory):
    file = tmp_path_factory.mktemp("reach") / "cell.yaml"
    text = SIMULATED.read_text(encoding="utf-8")
    file.write_text(text.replace("range_um: [2, 128], slew", f"range_um: [{LOW_UM:g}, 128], slew", 1), encoding="utf-8")
    return prepare(file)


def played(prepared):
    cell = VirtualCell(prepared.parameters, prepared.wiring)
    cell.arm()
    rows = cell.run(SECONDS)
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)
    return rows["axis"][:, 0]


def test_it_is_told_how_far_each_axis_reaches(weak):
    ((key, said),) = range_warnings(weak.configuration)
    assert key == ("axes", "x", "setpoint", "range_um")
    assert said.startswith("axis x reaches -100 to 310 um by its model, without force, of the -300 to 300 um")
    assert said.endswith("with centre_um at the middle of its set-points, 87 um, it would reach -205 to 205 um")
    assert list(range_warnings(prepare(SIMULATED).configuration)) == []


def test_a_path_out_of_reach_is_not_lost(weak):
    """Its samples were refused, as if no such deviation could be: the path was held where it had left, then X-301."""
    limited, whole = played(weak), played(prepare(SIMULATED))
    at_end = limited["setpoint_um"] <= LOW_UM
    ends = np.flatnonzero(np.diff(np.concatenate([[0], at_end, [0]])))
    assert (ends[1::2] - ends[::2]).max() > 5000, "longer than a tracker may be silent"
    lost_um = np.abs(limited["true_stage_um"] - whole["true_stage_um"])
    since = np.arange(len(at_end)) - np.maximum.accumulate(np.where(at_end, np.arange(len(at_end)), -(10**6)))
    assert lost_um[at_end].max() > 50.0
    assert lost_um[(since > 20) & (since < 10**6)].max() < 10.0, "2 ms after it is back in reach"
    assert lost_um[(since > 200) & (since < 10**6)].max() < 1.0
    assert np.abs(np.diff(limited["setpoint_um"])).max() <= 2.0, "never faster than its slew limit"


AT_S = 4.0
CONTACT = "{start_s: 4.0, static_N: 60.0, rise_ms: 7.0, tooth_N: 40.0, noise_N: 5.0}"
"""60 N, 95 % of them there within 20 ms."""
MAKES = {
    "nominal": {},
    "soft": {"flexure_N_per_um": 1.0},
    "light": {"stage_kg": 6.0, "flexure_N_per_um": 3.0},
    "quiet sensors": {"stage_noise_nm": 2.0, "strain_noise_nm": 10.0},
    "heavy": {"stage_kg": 13.0, "flexure_N_per_um": 2.6, "damping": 0.006},
    "weak": {"piezo_N_per_um": 300.0, "preisach_c_um_per_V2": 1.1e-2, "creep_per_operator": 0.008},
}


def made(prepared, make):
    """The factory's cell with the plant of `make` in axis x."""
    options = prepared.wiring.options["cell"]
    plant = options.plant.model_copy(update=MAKES[make])
    options = options.model_copy(update={"variation": options.variation | {"x": plant}})
    return with_options(prepared, "cell", options)


def on_hardware(folder, make, force=CONTACT, fault=""):
    """The factory's cell of that make, with the limits of hardware."""
    text = (CONFIG / "factory.yaml").read_text(encoding="utf-8").replace("limits: simulation", "limits: hardware")
    scheduled = f"    faults: [{{at_s: {AT_S}, {fault}}}]\n" if fault else ""
    text = text.replace("    driver: simulated\n", f"    driver: simulated\n    force: {force}\n{scheduled}", 1)
    file = folder / f"{make}.yaml"
    file.write_text(text, encoding="utf-8")
    return made(prepare(file), make)


OTHERS = [
    pytest.param(make, marks=[pytest.mark.xdist_group(f"tool entry {make}"), pytest.mark.thorough])
    for make in MAKES
    if make != "nominal"
]
"""Each is commissioned once, not by each worker."""


@pytest.fixture(scope="module", params=["nominal", *OTHERS])
def commissioned(request):
    """A make, and its axis x as `commission` tunes it, under the limits that the factory's file has."""
    if request.param == "nominal":  # commissioned by the campaign `tune`
        axis = prepare(CONFIG / "simulated.yaml").configuration.axes["x"]
        return request.param, axis.model_copy(update={"mode": "stage"})
    prepared = made(prepare(CONFIG / "factory.yaml"), request.param)
    configuration = prepared.configuration
    found = commission_axis(configuration, VirtualExperiment(prepared), "x", lambda _: None, Options(tooth_Hz=200.0))
    return request.param, found.configuration.axes["x"].model_copy(update={"mode": "stage"})


def run(prepared, axis, seconds=0.6):
    """Rows from the contact, or the fault, on; the cell."""
    configuration = prepared.configuration
    reference = configuration.reference.model_copy(update={"offset_um": 0.0})
    axes = {**configuration.axes, "x": axis.model_copy(update={"faults": configuration.axes["x"].faults})}
    # the other axes rest at their working points
    for name in "yz":
        axes[name] = axes[name].model_copy(update={"mode": "voltage"})
    configuration = configuration.model_copy(update={"axes": axes, "reference": reference})
    cell = VirtualExperiment(prepared, process=True).cell(configuration)
    cell.arm()
    cell.run(AT_S - float(cell.state[0]["cycle"]) * 1e-4)
    assert cell.state[0]["fault"] == NO_FAULT
    return cell.run(seconds), cell


@pytest.mark.long
def test_the_tool_comes_into_contact(commissioned, tmp_path):
    make, axis = commissioned
    rows, cell = run(on_hardware(tmp_path, make), axis)
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)
    error_um = rows["axis"]["reference_um"][:, 0] - rows["axis"]["stage_um"][:, 0]
    assert np.abs(error_um).max() < 10.0
    bent_um = 60.0 / MAKES[make].get("flexure_N_per_um", Plant().flexure_N_per_um)
    assert error_um[3000:].std() < 0.025 * bent_um, "what the force does without control, a fortieth of it"


@pytest.mark.long
@pytest.mark.parametrize("offset_um", [3.0, -3.0])
def test_a_sensor_that_is_off_is_found(commissioned, tmp_path, offset_um):
    """Within a millisecond, with the tool in the cut."""
    make, axis = commissioned
    cutting = CONTACT.replace("start_s: 4.0", "start_s: 2.0")
    fault = f"channel: stage_x, kind: offset, value: {offset_um}"
    rows, cell = run(on_hardware(tmp_path, make, cutting, fault), axis)
    assert (cell.state[0]["fault"], cell.state[0]["fault_axis"]) == (DISAGREEMENT, 0)
    assert int(np.argmax(rows["fault"] != 0)) <= 10


def test_behind_a_bus_the_contact_is_no_disagreement_either(tmp_path):
    text = (CONFIG / "simulated_1khz.yaml").read_text(encoding="utf-8")
    text, count = re.subn(r"(?m)^    force: .*$", f"    force: {CONTACT}", text)
    assert count == 1
    assert text.count("  axis: {") == 1
    file = tmp_path / "bus.yaml"
    file.write_text(text.replace("  axis: {", "  axis: {disagreement: {ratio: 25.0}, "), encoding="utf-8")
    prepared = prepare(file)
    cell = VirtualExperiment(prepared, process=True).cell(prepared.configuration)
    cell.arm()
    cell.run(2.0 + AT_S - float(cell.state[0]["cycle"]) * 1e-4)
    assert (cell.state[0]["state"], cell.state[0]["fault"]) == (TRACKING, NO_FAULT)


def test_what_the_process_may_do_is_asked_for(tmp_path):
    """The larger the process, the more may the innovation be; without one it is what the filter expects at rest."""
    prepared = prepare(CONFIG / "simulated.yaml")

    def limits(**said):
        configuration = prepared.configuration
        axes = {
            name: axis.model_copy(
                update={
                    "faults": axis.faults.model_copy(
                        update={"disagreement": axis.faults.disagreement.model_copy(update=said)}
                    )
                }
            )
            for name, axis in configuration.axes.items()
        }
        record = compile_cell(configuration.model_copy(update={"axes": axes}), prepared.wiring)[0]["axis"][0]
        return record["watch"]["innovation_ratio"], record["outer"]["innovation_um"]

    (none, at_rest_um), (usual, _), (large, large_um) = (
        limits(ratio=25.0, process_um=size) for size in (0.0, 60.0, 120.0)
    )
    assert none == 25.0
    assert large - 25.0 == pytest.approx(4.0 * (usual - 25.0))
    assert large_um > at_rest_um
    assert limits(ratio=None, process_um=60.0)[0] == np.inf
