"""An axis without `inner` is untuned: it stays in open loop until `commission` has found its loops."""

import pytest

from micromanip.errors import ConfigError
from micromanip.settings.check import prepare

UNTUNED = """\
schema_version: 2
loop: {rate_hz: 10000, cpu: null, limits: simulation}
drivers: {cell: {driver: simulated, axes: [x], seed: 1}}
signals: {strain_x: {driver: cell, range_um: [-30, 150]}, stage_x: {driver: cell, range_um: [-300, 300]}}
outputs: {voltage_x: {driver: cell, range_V: [-20, 150], slew_V_per_ms: 40}}
reference: {source: jog, offset_um: 0, range_um: [-15, 100]}
axes: {x: {centre_um: 66, setpoint: {range_um: [2, 128], slew_um_per_ms: 20}}}
"""


def prepared(tmp_path, text):
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    return prepare(file)


def test_it_moves_in_open_loop(tmp_path):
    axis = prepared(tmp_path, UNTUNED).configuration.axes["x"]
    assert axis.untuned
    assert axis.mode == "voltage"


@pytest.mark.parametrize("mode", ["strain", "stage"])
def test_its_loops_stay_open_whatever_is_asked(tmp_path, mode):
    with pytest.raises(ConfigError, match=rf"mode {mode} needs the section inner; without it the axis is untuned"):
        prepared(tmp_path, UNTUNED.replace("{centre_um", f"{{mode: {mode}, centre_um"))


def test_one_with_a_section_inner_is_tuned(tmp_path):
    tuned = UNTUNED.replace(
        "{centre_um",
        "{inner: {mode: pid, K_V_per_um: 0.6, Ti_ms: 0.6, Td_ms: 0, filter_ms: 0}, mode: strain, centre_um",
    ).replace("offset_um: 0, range_um: [-15, 100]", "offset_um: 66, range_um: [2, 128]")
    assert not prepared(tmp_path, tuned).configuration.axes["x"].untuned
