"""The budget's line `coupling`, of a cell whose axes are decoupled."""

from pathlib import Path

import pytest
import yaml

from micromanip.design.analyse.budget.configured import cell_of
from micromanip.settings.check import prepared
from micromanip.settings.text.source import Source

SIMULATED = Path(__file__).parents[4] / "config" / "simulated.yaml"
ROWS = [[1.0, 0.05, -0.03], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def neighbours(**section):
    document = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))
    document["drivers"]["cell"]["couplings"] = ROWS
    if section:
        document["axes"]["x"]["coupling"] = section
    cell = prepared(Source.parse(Path("cell.yaml"), yaml.safe_dump(document, sort_keys=False)))
    return cell_of(cell, "x").known.neighbours


def test_what_is_left_is_what_the_share_is_off_by():
    ignored, known = neighbours(), neighbours(share={"y": 0.05, "z": -0.03}, decouple=False)
    assert known == ignored
    assert max(abs(um) for _, um in ignored) == pytest.approx(0.05 * 130.0)
    exact = neighbours(share={"y": 0.05, "z": -0.03}, decouple=True)
    assert [hertz for hertz, _ in exact] == [hertz for hertz, _ in ignored]
    assert max(abs(um) for _, um in exact) < 1e-9
    half = neighbours(share={"y": 0.025, "z": -0.015}, decouple=True)
    assert [um for _, um in half] == pytest.approx([0.5 * um for _, um in ignored])
