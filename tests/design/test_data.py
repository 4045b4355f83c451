"""What is wrong with a recording is said in one sentence, with what to record instead."""

import re

import numpy as np
import pytest

from micromanip.design.data import load_record
from micromanip.errors import CheckFailed
from micromanip.recordings import Wanted


def good(samples=1000):
    """Columns of a record that can be used: a play operator moved up and down ten times."""
    t = np.arange(samples) * 0.01
    u = 50.0 + 40.0 * np.sin(2 * np.pi * t)
    y, state = np.empty(samples), u[0]
    for k, value in enumerate(u):
        state = max(value - 5.0, min(value + 5.0, state))
        y[k] = value + state
    return {"t_s": t, "voltage_V": u, "strain_um": y}


def write(file, columns):
    table = np.column_stack(list(columns.values()))
    np.savetxt(file, table, "%.9g", ",", header=",".join(columns), comments="")
    return file


def constant_input(columns):
    columns["voltage_V"][:] = 60.0


def too_short(columns):
    for name, values in columns.items():
        columns[name] = values[:150]


def clipped_above(columns):
    np.minimum(columns["strain_um"], 170.0, out=columns["strain_um"])


def clipped_before_the_noise(columns):
    """By an amplifier ahead of the converter, whose noise is still seen."""
    np.minimum(columns["strain_um"], 165.0, out=columns["strain_um"])
    columns["strain_um"] += np.random.default_rng(1).normal(0.0, 0.02, len(columns["strain_um"]))


def swapped(columns):
    columns["voltage_V"], columns["strain_um"] = columns["strain_um"], columns["voltage_V"]


def standing_time(columns):
    columns["t_s"][:] = 0.0


def falling(columns):
    columns["strain_um"] *= -1.0


def unrelated(columns):
    columns["strain_um"] = np.random.default_rng(1).standard_normal(len(columns["t_s"]))


def one_way(columns):
    for name, values in columns.items():
        columns[name] = np.linspace(values[0], values[0] + 10.0, len(values))


BAD = {
    constant_input: "{file}: voltage_V is constant: record while the actuator moves over the stroke that it will use",
    too_short: "{file}: 150 samples are too few; record at least 200",
    clipped_above: "{file}: strain_um sticks at its top value 170 for 14 samples while the input "
    "goes on outwards: the sensor is clipped; shift its range, or record a smaller movement",
    clipped_before_the_noise: "{file}: strain_um sticks near its top value 165.055, but for noise, for 20 samples "
    "while the input goes on outwards: the sensor is clipped; shift its range, or record a smaller movement",
    swapped: "{file}: strain_um runs ahead of voltage_V: the columns are probably mixed up "
    "(--input is the voltage, --output the displacement)",
    standing_time: "{file}:3: t_s stands still here (999 of 999 steps do not rise); a time column rises with every "
    "sample: name another with --time, cut the file there, or take its rows as even, --time none --dt SECONDS",
    falling: "{file}: strain_um falls when voltage_V rises: turn the sensor's sign, or name the right columns",
    unrelated: "{file}: strain_um hardly follows voltage_V (correlation {any}): "
    "are these the columns of one axis, recorded together?",
    one_way: "{file}: voltage_V passes its middle only {any} times: record at least two full periods",
}
NO_TABLE = (
    "{file}: not a table of numbers: one row per sample, separated by commas, semicolons, tabs or spaces, is read"
)
TEXTS = {
    b"": "{file}: it is empty; a recording is CSV or other text, .mat, .npy, .npz, MCAP, HDF5 or Parquet",
    b"t_s,voltage_V,strain_um\n": NO_TABLE,
    b"\x89PNG\r\n\x1a\n\xff": "{file}: neither text nor a format that is known here; "
    "save it as CSV, .mat, .npz, HDF5 or Parquet",
    b"Dear reader,\nthis is a letter.\n": NO_TABLE,
    b"t_s,voltage_V,strain_um\n0,1,2\n1,2,3\n2,3\n": "{file}:4: this row has not as many values as there are columns "
    "(2, the others have 3); the file's last row: it may be cut off, remove it",
    b"t_s;voltage;strain_um\n0;1;2\n1;2;3\n": "{file}: there is no column voltage_V; did you mean voltage?",
}


def sentence(pattern, file):
    """The whole sentence as a regular expression."""
    return "^" + re.escape(pattern).replace(r"\{file\}", re.escape(str(file))).replace(r"\{any\}", r"-?[\d.]+") + "$"


def load(file, **options):
    return load_record(file, Wanted(("voltage_V", "strain_um"), **options))


@pytest.mark.parametrize("spoil", BAD, ids=lambda spoil: spoil.__name__)
def test_bad_data_is_one_sentence(spoil, tmp_path):
    columns = good()
    spoil(columns)
    file = write(tmp_path / "bad.csv", columns)
    with pytest.raises(CheckFailed, match=sentence(BAD[spoil], file)):
        load(file)


@pytest.mark.parametrize("text", TEXTS, ids=["empty", "header", "picture", "letter", "ragged", "semicolons"])
def test_no_table_is_one_sentence(text, tmp_path):
    file = tmp_path / "bad.csv"
    file.write_bytes(text)
    with pytest.raises(CheckFailed, match=sentence(TEXTS[text], file)):
        load(file)


@pytest.mark.parametrize(("step", "noise"), [(0.0, 0.01), (0.02, 0.0), (0.25, 0.0), (0.25, 0.06), (1.0, 0.0)])
def test_an_output_that_rests_behind_each_turn_is_not_clipped(step, noise, tmp_path):
    """A hysteresis of one wide play: the input goes back by a quarter of its way until the output follows.

    Also seen by a sensor with steps, up to an 80th of its stroke, which shows no more at the top of a sine.
    """
    columns = good(4000)
    columns["voltage_V"] = 50.0 + 40.0 * np.sin(0.5 * np.pi * columns["t_s"])
    state = columns["voltage_V"][0]
    for k, value in enumerate(columns["voltage_V"]):
        state = columns["strain_um"][k] = max(value - 10.0, min(value + 10.0, state))
    columns["strain_um"] += np.random.default_rng(1).normal(0.0, noise, len(columns["strain_um"]))
    if step:
        columns["strain_um"] = np.round(columns["strain_um"] / step) * step
    load(write(tmp_path / "play.csv", columns))
