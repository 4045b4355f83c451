"""The section `actuator` of an axis: what is refused, and in which modes it does anything at all."""

import pytest
import yaml

from campaigns.report import CONFIG
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare

PAPER = CONFIG / "paper.yaml"

RESONANCE = {"resonance_Hz": 63.0, "resonance_damping": 0.04, "antiresonance_Hz": 67.0, "antiresonance_damping": 0.038}
SECTION = {"delay_us": 190.0, "gauge_us": 64.0, "lag_us": 177.0, "feedback_percent": 80.0, "resonances": [RESONANCE]}


def compiled(tmp_path, actuator, mode="strain", inner_mode="pid+feedforward", reference=None):
    made = yaml.safe_load(PAPER.read_text(encoding="utf-8"))
    if reference is not None:
        made["reference"] = reference
    for axis in made["axes"].values():
        axis["mode"] = mode
        axis["inner"]["mode"] = inner_mode
        axis["actuator"] = actuator
    file = tmp_path / "cell.yaml"
    file.write_text(yaml.safe_dump(made, sort_keys=False), encoding="utf-8")
    return prepare(file).parameters[0]["axis"][0]


HOLD = {"source": "hold", "offset_um": 60.0}


def test_it_becomes_cycles_and_gains(tmp_path):
    with_it, without = (compiled(tmp_path, each, reference=HOLD) for each in (SECTION, None))
    assert with_it["preview_s"] == pytest.approx(190e-6)
    assert with_it["awaited_cycles"] == pytest.approx(2.54)
    assert with_it["hysteresis"]["resonances"] == 1
    for gain in ("K_V_per_um", "integral", "derivative"):
        assert with_it["pid"][gain] == pytest.approx(0.8 * without["pid"][gain])
        assert with_it["fallback"][gain] / with_it["pid"][gain] == without["fallback"][gain] / without["pid"][gain]


def test_a_reference_that_is_not_known_is_not_followed_ahead(tmp_path):
    by_hand = {"source": "jog", "offset_um": 60.0, "range_um": [40.0, 80.0], "speed_um_per_s": 50.0, "target_um": {}}
    a = compiled(tmp_path, SECTION, reference=by_hand)
    assert a["preview_s"] == 0.0
    assert a["awaited_cycles"] > 0.0


@pytest.mark.parametrize(
    ("section", "told"),
    [
        ({"resonances": [RESONANCE | {"antiresonance_Hz": 4600.0}]}, r"resonances\[?.0.*antiresonance_Hz.*4500 Hz"),
        ({"delay_us": 12_000.0, "gauge_us": 900.0}, r"12900 us together: at most 12800 us"),
    ],
)
def test_what_can_not_be_undone_is_refused_with_its_key(tmp_path, section, told):
    with pytest.raises(ConfigError, match=rf"(?s)cell\.yaml:\d+.*actuator.*{told}"):
        compiled(tmp_path, section, reference=HOLD)
