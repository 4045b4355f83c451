"""A recording in other formats, read back by their own libraries: bit for bit what the ring held."""

import json

import h5py
import numpy as np
import pytest
from cli.command import code_of
from host.test_mcap_recording import begun, slots, some_rows
from pyarrow import parquet

from micromanip.errors import UsageError
from micromanip.recordings import open_telemetry, read_table
from micromanip.recordings.export import export
from micromanip.rt.telemetry import AXIS_ROW, ROW


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording in which two cycles were skipped, and its rows."""
    file = tmp_path_factory.mktemp("export") / "run.mcap"
    rows = np.concatenate([some_rows(42, 800), some_rows(844, 700)])
    rows["periods"][800] = 3
    recording = begun(file)
    recording.append(rows, slots(1))
    recording.close()
    return file, rows


def bits(values):
    return np.ascontiguousarray(values).view(f"i{np.asarray(values).itemsize}").tolist()


def columns_of(rows):
    """Every column of the two axes that the file is of, by name."""
    found = {name: rows[name] for name in ROW.names if name != "axis"}
    for place, axis in enumerate("xy"):
        found |= {f"{name}_{axis}": rows["axis"][name][:, place] for name in AXIS_ROW.names}
    return found


def test_hdf5(recorded, tmp_path):
    file, rows = recorded
    done = export(open_telemetry(file), tmp_path / "run.h5")
    with h5py.File(tmp_path / "run.h5") as found:
        for name, values in columns_of(rows).items():
            assert found[name].dtype == values.dtype
            assert bits(found[name][:]) == bits(values), name
        assert found["strain_um_x"].attrs["units"] == "um"
        assert found.attrs["configuration"] == open_telemetry(file).configuration
    assert done.rows == len(rows)
    ours, theirs = read_table(file), read_table(tmp_path / "run.h5")
    assert set(ours) == set(theirs)
    assert all(bits(ours[name]) == bits(theirs[name]) for name in ours)


def test_parquet(recorded, tmp_path):
    file, rows = recorded
    export(open_telemetry(file), tmp_path / "run.parquet")
    found = parquet.read_table(tmp_path / "run.parquet")
    expected = columns_of(rows)
    assert set(found.column_names) == {"t_s", *expected}
    for name, values in expected.items():
        column = found.column(name).to_numpy()
        assert column.dtype == values.dtype
        assert bits(column) == bits(values), name
    assert found.schema.field("strain_um_x").metadata[b"unit"] == b"um"
    assert found.schema.metadata[b"sha256"] == b"abc"
    assert found.column("t_s").to_numpy() == pytest.approx((rows["cycle"] - 42) * 1e-4)


def test_csv(recorded, tmp_path):
    file, rows = recorded
    export(open_telemetry(file), tmp_path / "run.csv", signals=["cycle", "stage_um"])
    head, *lines = (tmp_path / "run.csv").read_text().splitlines()
    assert head == "t_s,cycle,stage_um_x,stage_um_y"
    found = np.array([[float(value) for value in line.split(",")] for line in lines])
    assert (found[:, 1] == rows["cycle"]).all()
    assert bits(found[:, 2]) == bits(rows["axis"]["stage_um"][:, 0])
    table = read_table(tmp_path / "run.csv")
    assert bits(table["stage_um_y"]) == bits(rows["axis"]["stage_um"][:, 1])


@pytest.mark.parametrize("kind", [".h5", ".hdf5", ".parquet", ".mat", ".MAT", ".CSV", ".npz"])
def test_a_part(recorded, tmp_path, kind):
    """By the counter of cycles: the skipped ones count."""
    file, rows = recorded
    done = export(open_telemetry(file), tmp_path / f"part{kind}", (0.07, 0.0903), ["stage_um_y", "fault"])
    kept = rows[(rows["cycle"] >= 42 + 700) & (rows["cycle"] <= 42 + 903)]
    assert done.rows == len(kept) == 202
    table = read_table(tmp_path / f"part{kind}")
    assert sorted(table) == ["fault", "stage_um_y", "t_s"]
    assert bits(table["stage_um_y"]) == bits(kept["axis"]["stage_um"][:, 1])
    assert table["t_s"][0] == pytest.approx(0.07)


@pytest.mark.parametrize(
    ("to", "signals", "said"),
    [
        ("run.xlsx", (), r"expected a file that ends in \.h5, \.hdf5, \.parquet, \.csv, \.mat, \.npz"),
        ("there.h5", (), "is there already"),
        ("no/folder/run.h5", (), "No such file or directory"),
        ("run.csv", ("stran_um_x",), "no column stran_um_x; did you mean strain_um_x"),
    ],
)
def test_what_can_t_be_exported(recorded, tmp_path, to, signals, said):
    (tmp_path / "there.h5").write_text("precious")
    with pytest.raises(UsageError, match=said):
        export(open_telemetry(recorded[0]), tmp_path / to, signals=signals)
    assert [path.name for path in tmp_path.iterdir()] == ["there.h5"]
    assert (tmp_path / "there.h5").read_text() == "precious"


def test_the_command(recorded, tmp_path, capsys):
    to = tmp_path / "run.csv"
    part = ("--signals", "strain_um, fault", "--cut", ":0.01")
    assert code_of("recording", "export", recorded[0], "--to", to, *part, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {
        "file": str(to), "rows": 101, "columns": ["t_s", "strain_um_x", "strain_um_y", "fault"],
        "bytes": to.stat().st_size,
    }  # fmt: skip
    assert code_of("recording", "export", recorded[0], "--to", to) == 64
    assert "nothing is replaced" in capsys.readouterr().err


@pytest.mark.parametrize("ending", ["csv", "h5", "parquet", "mat", "npz"])
def test_a_part_behind_the_end_is_refused(recorded, tmp_path, ending):
    file, _ = recorded
    with pytest.raises(UsageError, match=r"no cycle is within --cut; it has 0\.1501 s$"):
        export(open_telemetry(file), tmp_path / f"none.{ending}", (5.0, 6.0))
    assert list(tmp_path.iterdir()) == []
