"""The tracker's frame in a configuration: what fits, what is refused, and that a turned tracker changes nothing."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from micromanip.errors import ConfigError
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"
TURN = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
"""A rotation: what the tracker reads of the axes."""


def framed(matrix=None, signals=("tracker_1", "tracker_2", "tracker_3"), **frame):
    """The tuned cell with a turned tracker without noise."""
    document = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    document["drivers"]["cell"]["tracker"].update(noise_um=0.0, coordinates=TURN)
    for axis, name in zip("xyz", ("tracker_1", "tracker_2", "tracker_3"), strict=True):
        entry = document["signals"].pop(f"deviation_{axis}")
        document["signals"][name] = {**entry, "channel": f"deviation_{axis}"}
    matrix = np.transpose(TURN).tolist() if matrix is None else matrix
    document["reference"]["frame"] = {"signals": list(signals), "matrix": matrix, **frame}
    return document


def prepared(tmp_path, document):
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return prepare(file)


@pytest.mark.compiled_only
def test_a_turned_tracker_gives_the_same_as_one_along_the_axes(tmp_path):
    plain = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    plain["drivers"]["cell"]["tracker"]["noise_um"] = 0.0
    rows = []
    for document in (plain, framed(offset_um=[0.0, 0.0, 0.0])):
        cell = prepared(tmp_path, document)
        virtual = VirtualCell(cell.parameters, cell.wiring, cell.samples)
        virtual.arm()
        rows.append(virtual.run(0.5)["axis"])
    assert np.ptp(rows[0]["reference_um"], axis=0).min() > 5.0
    for name in ("reference_um", "voltage_V", "true_stage_um"):
        assert np.abs(rows[0][name] - rows[1][name]).max() < 1e-6
    assert (rows[0]["deviation_age_ns"] == rows[1]["deviation_age_ns"]).all()


def test_derived_signals_stand_after_the_drivers_inputs(tmp_path):
    cell = prepared(tmp_path, framed())
    inputs = len(cell.wiring.drivers["cell"].inputs)
    assert [cell.wiring.signal(f"deviation_{axis}") for axis in "xyz"] == [inputs, inputs + 1, inputs + 2]
    assert set(cell.parameters[0]["axis"]["reference_age_ns"]) == {3_000_000}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"matrix": [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]}, "matrix: a row has 2 numbers, there are 3 signals"),
        ({"matrix": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]}, "2 rows for 3 axes"),
        ({"matrix": [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 1.0]]}, "its rank is 2"),
        ({"matrix": [[float("nan"), 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "nan"),
        ({"offset_um": [1.0]}, "1 numbers for 3 rows"),
        ({"signals": ("tracker_1", "tracker_1", "tracker_3")}, "each coordinate once"),
        ({"signals": ("tracker_1", "tracker_2", "tracker_9")}, "the section signals has no tracker_9"),
        ({"signals": ("tracker_1", "tracker_2", "deviation_z")}, "must be named tracker_<name>"),
    ],
)
def test_what_is_no_frame(tmp_path, change, says):
    with pytest.raises(ConfigError) as refused:
        prepared(tmp_path, framed(**change))
    assert says in str(refused.value)


def test_a_deviation_is_read_or_computed_not_both(tmp_path):
    document = framed()
    document["signals"]["deviation_x"] = {"driver": "cell"}
    with pytest.raises(ConfigError, match=r"signals\.deviation_x: reference\.frame computes it already"):
        prepared(tmp_path, document)


def test_coordinates_that_nobody_uses(tmp_path):
    document = framed()
    del document["reference"]["frame"]
    with pytest.raises(ConfigError, match=r"signals\.tracker_1: no frame uses it"):
        prepared(tmp_path, document)
