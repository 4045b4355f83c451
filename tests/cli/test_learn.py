"""`micromanip learn`: a memory as CSV; what is asked of the running cell is in tests/host/test_learning_service.py."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from micromanip.cli.commands import cli
from micromanip.design.learning.memory import Memory, write_memory
from micromanip.errors import CheckFailed, UsageError


def asked(*words):
    return CliRunner().invoke(cli, ["learn", *(str(word) for word in words)])


def test_export_writes_a_memory_as_csv_and_replaces_nothing(tmp_path):
    rows = np.random.default_rng(1).normal(size=(3, 50))
    write_memory(tmp_path / "x.npz", Memory("cell", "x", "tuning", 1000.0, *rows, parts=2))
    found = asked("export", tmp_path / "x.npz", tmp_path / "x.csv", "--json")
    assert json.loads(found.stdout)["rows"] == 50
    table = np.loadtxt(tmp_path / "x.csv", delimiter=",", skiprows=1)
    assert table[:, 0] == pytest.approx(np.arange(50) / 1000.0)
    assert table[:, 1:].T == pytest.approx(rows, rel=1e-5)
    assert isinstance(asked("export", tmp_path / "x.npz", tmp_path / "x.csv").exception, UsageError)
    (tmp_path / "y.npz").write_bytes(b"not one")
    assert isinstance(asked("export", tmp_path / "y.npz", tmp_path / "y.csv").exception, CheckFailed)
    assert not (tmp_path / "y.csv").exists()
