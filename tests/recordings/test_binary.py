"""Files of MATLAB, NumPy, HDF5 and Parquet, written by the libraries that others write them with."""

import datetime
import pickle

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from micromanip.errors import CheckFailed
from micromanip.recordings import Wanted, read_table, take

from .signals import SAMPLES, STEP_S, T, U, Y


def mat(file, **options):
    savemat(file, {"t": T, "u": U, "y": Y, "operator": "lab", "gain": 3.0}, **options)
    return ("u", "y")


def mat_4(file):
    return mat(file, format="4")


def mat_compressed(file):
    return mat(file, do_compression=True, oned_as="column")


def mat_matrix(file):
    savemat(file, {"data": np.column_stack([T, U, Y])})
    return ("data.2", "data.3")


def mat_simulink(file):
    signals = {"values": Y[:, None], "label": "gauge"}
    savemat(file, {"out": {"time": T[:, None], "signals": signals}, "u": U})
    return ("u", "out.signals.values")


def mat_73(file):
    """As MATLAB's ``save -v7.3``: a user block, then HDF5 with arrays turned round and their classes."""
    with h5py.File(file, "w", userblock_size=512) as contents:
        for name, values in (("t", T), ("u", U), ("y", Y)):
            contents.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        text = contents.create_dataset("note", data=np.frombuffer(b"lab", np.uint8).astype(np.uint16)[:, None])
        text.attrs["MATLAB_class"] = np.bytes_("char")
        contents.create_group("#refs#").create_dataset("a", data=np.zeros((3, 2)))
    with file.open("r+b") as head:
        head.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\0\2IM")
    return ("u", "y")


def npy_matrix(file):
    np.save(file, np.column_stack([T, U, Y]))
    return ("2", "3")


def npy_rows(file):
    np.save(file, np.stack([T, U, Y]))
    return ("2", "3")


def npy_structured(file):
    table = np.zeros(SAMPLES, [("t", "f8"), ("u", "f4"), ("y", "f8"), ("flag", "S4")])
    table["t"], table["u"], table["y"] = T, U, Y
    np.save(file, table)
    return ("u", "y")


def npz(file):
    np.savez(file, t=T, u=U, y=Y, comment=np.array("lab"))
    return ("u", "y")


def npz_compressed(file):
    np.savez_compressed(file, time=T, signals=np.column_stack([U, Y]))
    return ("signals.1", "signals.2")


def hdf5(file):
    with h5py.File(file, "w") as contents:
        group = contents.create_group("bench/run1")
        group["t"], group["amp"], group["gauge"] = 1e3 * T, U, 1e-3 * Y
        group["t"].attrs["units"], group["gauge"].attrs["unit"] = "ms", "mm"
        contents["version"] = 3
    return ("amp", "gauge")


def hdf5_table(file):
    with h5py.File(file, "w") as contents:
        table = np.zeros(SAMPLES, [("t", "f8"), ("u", "f8"), ("y", "f4")])
        table["t"], table["u"], table["y"] = T, U, Y
        contents.create_dataset("rows", data=table, chunks=(100,), compression="gzip")
    return ("u", "y")


def netcdf(file):
    """Packed by factor and offset, the units in arrays, as netCDF and MATLAB's h5writeatt have them."""
    with h5py.File(file, "w") as contents:
        contents["t"], contents["u"] = 1e3 * T, U
        contents["y"] = np.rint((Y - 50.0) / 1e-6).astype("i4")
        contents["t"].attrs["units"] = "milliseconds since 2026-11-24 10:00:00"
        contents["u"].attrs["units"] = np.array([b"V"])
        contents["y"].attrs.update(units=np.array(["um"], object), scale_factor=np.array([1e-6]), add_offset=50.0)
    return ("u", "y")


def parquet(file):
    pq.write_table(pa.table({"t": T, "u (V)": U, "y (mm)": 1e-3 * Y, "who": ["lab"] * SAMPLES}), file)
    return ("u", "y")


def parquet_stamped(file):
    """As a data frame with an index of time stamps."""
    begin = datetime.datetime(2024, 3, 1, 12)
    stamps = pa.array([begin + datetime.timedelta(seconds=float(t)) for t in T], pa.timestamp("us"))
    pq.write_table(pa.table({"u": U, "y": pa.array(Y, pa.float32()), "__index_level_0__": stamps}), file)
    return ("u", "y")


WRITERS = {
    mat: "x.mat", mat_4: "x.mat", mat_compressed: "x.mat", mat_matrix: "x.mat", mat_simulink: "x.mat", mat_73: "x.mat",
    npy_matrix: "x.npy", npy_rows: "x.npy", npy_structured: "x.npy", npz: "x.npz", npz_compressed: "x.npz",
    hdf5: "x.h5", netcdf: "x.nc", hdf5_table: "x.hdf5", parquet: "x.parquet", parquet_stamped: "x.parquet",
}  # fmt: skip
MATRICES = {mat_matrix: "data.1", npy_matrix: "1", npy_rows: "1"}


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_each_format_gives_the_same_numbers(write, tmp_path):
    file = tmp_path / WRITERS[write]
    columns = write(file)
    taken = take(file, Wanted(columns, MATRICES.get(write)))
    assert taken.step_s == pytest.approx(STEP_S)
    assert (taken.index == np.arange(SAMPLES)).all()
    np.testing.assert_allclose(taken.values, np.column_stack([U, Y]), rtol=2e-7)


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
@pytest.mark.parametrize("share", [0.05, 0.5, 0.97])
def test_a_file_that_is_cut_off_is_one_sentence(write, share, tmp_path):
    whole, file = tmp_path / WRITERS[write], tmp_path / f"half-{WRITERS[write]}"
    columns = write(whole)
    content = whole.read_bytes()
    file.write_bytes(content[: max(8, round(share * len(content)))])
    with pytest.raises(CheckFailed, match=rf"^{file}: ") as raised:
        take(file, Wanted(columns, MATRICES.get(write)))
    assert "\n" not in str(raised.value)


class Trap:
    """Runs when it is unpickled."""

    def __reduce__(self):
        return (pytest.fail, ("it was unpickled",))


def test_objects_are_never_loaded(tmp_path):
    for name, save in (("x.npy", np.save), ("x.npz", np.savez)):
        save(tmp_path / name, np.array([Trap(), 1.0], dtype=object))
        with pytest.raises(CheckFailed, match="holds Python objects, which are never loaded"):
            read_table(tmp_path / name)
    (tmp_path / "x.pkl").write_bytes(pickle.dumps(Trap(), protocol=4))
    with pytest.raises(CheckFailed, match="a Python pickle, which is never loaded"):
        read_table(tmp_path / "x.pkl")


def test_an_archive_that_unpacks_to_more_than_fits_is_refused_before_it_is(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "x.npz", t=np.zeros(300_000))
    monkeypatch.setattr("micromanip.recordings.binary.MOST_BYTES", 1_000_000)
    with pytest.raises(CheckFailed, match="unpacked it is larger than 1 MB"):
        read_table(tmp_path / "x.npz")


FOREIGN = {
    b"\x1f\x8b\x08\0": r"compressed \(gzip\): unpack it first",
    b"TDSm\x0e\0": "LabVIEW TDMS: export it as text",
    b"PK\3\4\x14\0": "cut off or damaged",
    b"\0\1\2\3\4\5\6\7": "neither text",
    b"\x93NUMPY\1\0": "cut off or damaged",
    b"PAR1 and nothing": "cut off or damaged",
    b"\x89HDF\r\n\x1a\n": "cut off, damaged, or no HDF5",
}


@pytest.mark.parametrize("content", FOREIGN, ids=lambda content: content[:4].hex())
def test_foreign_files_are_one_sentence(content, tmp_path):
    file = tmp_path / "x.bin"
    file.write_bytes(content)
    with pytest.raises(CheckFailed, match=FOREIGN[content]) as raised:
        read_table(file)
    assert "\n" not in str(raised.value)


def test_columns_of_other_lengths_are_no_recording(tmp_path):
    np.savez(tmp_path / "x.npz", t=T, u=U, y=Y[:-1])
    with pytest.raises(CheckFailed, match=r"y has 599 values, t 600: not one recording"):
        take(tmp_path / "x.npz", Wanted(("u", "y")))
