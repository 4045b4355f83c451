"""Sections `coupling`: what is refused, and what is compiled of them."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from campaigns.report import CONFIG
from micromanip.control.outer_gains import dc_gain, steady_lag
from micromanip.control.stage_loop import model_system
from micromanip.errors import ConfigError
from micromanip.settings.check import prepared
from micromanip.settings.text.source import Source

SIMULATED = CONFIG / "simulated.yaml"
DOCUMENT = yaml.safe_load(SIMULATED.read_text(encoding="utf-8"))


def with_coupling(axis="x", *, outer=True, **section):
    document = {**DOCUMENT, "axes": {name: dict(entry) for name, entry in DOCUMENT["axes"].items()}}
    document["axes"][axis]["coupling"] = section
    if not outer:
        for entry in document["axes"].values():
            entry["mode"] = "strain"
        del document["axes"][axis]["outer"]
    return prepared(Source.parse(Path("cell.yaml"), yaml.safe_dump(document, sort_keys=False)))


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({"share": {"w": 0.01}}, "axes.x.coupling.share.w: there is no axis w; the axes are x, y, z"),
        ({"share": {"x": 0.01}}, "axes.x.coupling.share.x: an axis moves wholly with itself"),
        ({"share": {"y": 0.6}}, "axes.x.coupling.share.y: expected a number from -0.5 to 0.5"),
        ({"share": {"y": 0.3, "z": -0.3}}, "share: 0.6 of the others' motion, at most 0.5 are bearable"),
        ({"share": {"y": 0.01}, "decouple": "yes"}, "axes.x.coupling.decouple"),
        ({"share": {"y": 0.01}, "decouple": True, "outer": False}, "axes.x.coupling.decouple: needs the section outer"),
    ],
)
def test_what_is_no_coupling(section, says):
    with pytest.raises(ConfigError) as refused:
        with_coupling(**section)
    assert says in str(refused.value)


def test_shares_are_those_of_the_set_point_and_the_lead_is_the_slope_of_the_phase():
    cell = with_coupling(share={"y": 0.05, "z": -0.02}, decouple=True)
    law, outer = cell.parameters[0]["axis"][0]["decoupling"], cell.configuration.axes["x"].outer
    assert law["active"] == 1
    assert law["share"] == pytest.approx(np.array([0.0, 0.05, -0.02]) / dc_gain(outer))
    omega = np.array([2 * np.pi * 0.5])
    phase = np.angle(model_system(outer.model, 1e-4).response(omega))[0]
    assert steady_lag(outer) * 1e-4 == pytest.approx(-phase / omega[0], rel=1e-3)
    assert law["lead_s"] == pytest.approx((steady_lag(outer) + 1.0) * 1e-4)
    assert not cell.parameters[0]["axis"]["decoupling"]["active"][1:].any()


def test_an_axis_that_is_not_in_mode_stage_is_not_answered_to():
    document = {**DOCUMENT, "axes": {name: dict(entry) for name, entry in DOCUMENT["axes"].items()}}
    document["axes"]["x"]["coupling"] = {"share": {"y": 0.05, "z": 0.02}, "decouple": True}
    document["axes"]["y"]["mode"] = "strain"
    document["reference"] = {"source": "hold", "offset_um": 10.0}
    cell = prepared(Source.parse(Path("cell.yaml"), yaml.safe_dump(document, sort_keys=False)))
    share = cell.parameters[0]["axis"][0]["decoupling"]["share"]
    assert share[1] == 0.0
    assert share[2] > 0.0
