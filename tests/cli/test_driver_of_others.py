"""A driver that somebody else wrote, and that does not do: whose error it is, and where."""

import re
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from . import command

LAG_STAGE = Path(__file__).parents[2] / "docs" / "examples" / "lag_stage" / "cell.yaml"
THEIRS = """
import numpy as np
from pydantic import BaseModel, ConfigDict
from micromanip.driver import Compiler, CyclicDriver, Functions, entries

compiled = Compiler(__file__)
CONTEXT = np.dtype([("V", "f8")])

@compiled
def exchange(c, outputs, inputs, now_ns, periods):
    return c["unknown"]

@compiled
def rest(c):
    return 0

ENTRIES = entries(compiled, CONTEXT, rest, exchange, rest, rest)

class Options(BaseModel):
    model_config = ConfigDict(extra="forbid")

class Stage(CyclicDriver):
    Options = Options
    simulated = True
    inputs, outputs = ("strain",), ("voltage",)

    def __init__(self, options, period_ns):
        pass

    def context(self):
        return {context}

    def functions(self):
        return Functions(*ENTRIES.addresses)
"""


@pytest.mark.parametrize(
    ("context", "line", "says"),
    [
        ("np.zeros(1, CONTEXT)[1]", 31, "IndexError: index 1 is out of bounds"),
        ("np.zeros(1, CONTEXT).view(np.uint8)", 11, "[A-Za-z]+: .*unknown"),
    ],
)
def test_what_a_driver_of_others_does_wrong_is_told_as_its_author_s(context, line, says, monkeypatch, tmp_path, capsys):
    """Also where the compiler refuses it: that was a page of numba's, and a bug to be reported to us."""
    name = f"their_stage_{line}"
    (tmp_path / f"{name}.py").write_text(THEIRS.replace("{context}", context))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    point = EntryPoint("their_stage", f"{name}:Stage", "micromanip.drivers")
    monkeypatch.setattr("micromanip.bus.registry.entry_points", lambda **_: [point])
    cell = tmp_path / "cell.yaml"
    cell.write_text(LAG_STAGE.read_text().replace("lag_stage, um_per_V: 0.9, lag_ms: 0.5", "their_stage"))
    assert command.code_of("check", cell) == 70
    told = capsys.readouterr().err
    assert re.search(rf"bug of the driver their_stage \({name}:Stage\), \S*{name}.py:{line}: {says}", told)
    assert "report it to the driver's author" in told
    assert len([said for said in told.splitlines() if not said.startswith("compiling ")]) == 2
