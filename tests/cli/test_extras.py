"""Who asks for what an extra brings, and has not got it, reads what to install; it is no bug."""

import sys

import pytest

from .command import code_of

FIT = ("--input", "u", "--output", "y", "--burn-in", "0")


@pytest.mark.parametrize(
    ("missing", "extra", "arguments"),
    [
        ("h5py", "formats", ("fit", "hysteresis", "foreign.h5", *FIT)),
        ("h5py", "formats", ("fit", "hysteresis", "new.mat", *FIT)),
        ("pyarrow", "formats", ("fit", "hysteresis", "foreign.parquet", *FIT)),
        ("uvicorn", "gateway", ("gateway", "cell.yaml")),
    ],
)
def test_a_command_names_the_extra(missing, extra, arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "foreign.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    (tmp_path / "foreign.parquet").write_bytes(b"PAR1PAR1")
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n")
    monkeypatch.setitem(sys.modules, missing, None)
    for name in [name for name in sys.modules if name.startswith("micromanip.gateway")]:
        monkeypatch.delitem(sys.modules, name)
    assert code_of(*arguments) == 69
    said = capsys.readouterr().err
    assert f"needs {missing}: install micromanip with its extra {extra} " in said
