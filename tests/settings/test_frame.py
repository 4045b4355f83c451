"""The tracker's frame in a configuration: what fits, what is refused, and that a turned tracker changes nothing."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from campaigns.report import CONFIG
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare
from micromanip.virtual.cell import VirtualCell

SIMULATED = CONFIG / "simulated.yaml"
TURN = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
"""A rotation: what the tracker reads of the axes."""


def framed(matrix=None, signals=("tracker_1", "tracker_2", "tracker_3"), **frame):
    """The tuned cell with a turned tracker without noise."""
    document = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))
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
    plain = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))
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


MRAD = ("tracker_a", "tracker_b", "tracker_c")


def levered(**lever):
    document = framed()
    for name in MRAD:
        document["signals"][name] = dict(document["signals"]["tracker_1"])
    document["reference"]["frame"]["lever"] = {"signals": list(MRAD), "arm_mm": [0.0, 0.0, 100.0], **lever}
    return document


def test_a_lever_moves_the_tool_as_a_rotation_of_the_arm_does(tmp_path):
    """Beside rotation matrices, of angles about the tracker's axes; the rest is half the square of the angle."""
    arm_mm = np.array([40.0, -25.0, 100.0])
    frame = prepared(tmp_path, levered(arm_mm=arm_mm.tolist())).parameters[0]["frame"]
    assert (frame["sources"], frame["derived"]) == (6, 3)
    turn = np.transpose(TURN)  # of the tracker's coordinates into the cell's
    for mrad in np.random.default_rng(1).normal(scale=0.7, size=(20, 3)):
        turned = Rotation.from_rotvec(turn @ (1e-3 * mrad)).apply(arm_mm)
        linear_um = frame["matrix"][:, :6] @ [0.0, 0.0, 0.0, *mrad]
        square = 0.5 * np.sum((1e-3 * mrad) ** 2) * np.linalg.norm(arm_mm) * 1e3
        assert np.linalg.norm(1e3 * (turned - arm_mm) - linear_um) <= 1.01 * square
        assert np.linalg.norm(linear_um) > 20.0 * square


def test_a_target_at_the_tool_sees_what_the_far_one_computes(tmp_path):
    """A body moves by d and turns by theta: near target, and far target with its lever, give the same deviation."""
    arm_mm, moved_um, mrad = np.array([10.0, 200.0, -30.0]), np.array([5.0, -60.0, 20.0]), np.array([0.2, -0.1, 0.3])
    frame = prepared(tmp_path, levered(arm_mm=arm_mm.tolist())).parameters[0]["frame"]
    at_tool_um = moved_um + np.cross(np.transpose(TURN) @ mrad * 1e-3, arm_mm) * 1e3
    found = frame["matrix"][:, :6] @ [*(np.array(TURN) @ moved_um), *mrad]
    assert found == pytest.approx(at_tool_um)
    scaled = prepared(tmp_path, levered(arm_mm=arm_mm.tolist(), rad_per_unit=np.pi / 180.0)).parameters[0]["frame"]
    assert scaled["matrix"][:, 3:6] == pytest.approx(frame["matrix"][:, 3:6] * 1e3 * np.pi / 180.0)


@pytest.mark.parametrize(
    ("change", "lever", "says"),
    [
        ({"matrix": [[1.0, 0.0, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]]}, {}, "not orthogonal or of one length"),
        ({"matrix": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]}, {}, "the matrix is a reflection"),
        ({}, {"arm_mm": [0.0, 0.0, 0.0]}, "nothing comes of an arm of 0 mm"),
        ({}, {"signals": ["tracker_a", "tracker_b", "tracker_1"]}, "each coordinate once"),
        ({}, {"signals": ["tracker_a", "tracker_b", "tracker_x"]}, "frame.lever.signals: the section signals has"),
        ({}, {"signals": ["tracker_a", "tracker_b"]}, "reference.frame.lever.signals"),
    ],
)
def test_what_is_no_lever(tmp_path, change, lever, says):
    document = levered(**lever)
    document["reference"]["frame"] |= change
    with pytest.raises(ConfigError) as refused:
        prepared(tmp_path, document)
    assert says in str(refused.value)
