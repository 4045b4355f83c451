"""What a commissioned axis is judged by says why it was not met."""

from types import SimpleNamespace

import pytest

from campaigns.report import CONFIG
from micromanip.design.commission.acceptance import _sines
from micromanip.settings.load import load
from micromanip.settings.wiring.timing import AT_ONCE

FACTORY = CONFIG / "factory.yaml"


@pytest.mark.parametrize(("limit", "faster"), [(1.0, True), (1.9, True), (2.1, False)])
def test_a_sine_faster_than_the_set_points_slew_limit_names_both(limit, faster):
    configuration = load(FACTORY)
    axis = configuration.axes["x"]
    slow = axis.model_copy(update={"setpoint": axis.setpoint.model_copy(update={"slew_um_per_ms": limit})})
    found = SimpleNamespace(
        axis="x",
        configuration=configuration.model_copy(update={"axes": {"x": slow}}),
        polarity=SimpleNamespace(noise_um=0.05),
        actuator=SimpleNamespace(path=AT_ONCE),
    )
    run = SimpleNamespace(config="C", frequency_hz=10.0, figures=lambda *_: {"std_error_um": 14.4788})
    (criterion,) = _sines(found, [run], 0)
    # 31.5 um at 10 Hz: 1.98 um/ms at most
    assert criterion[2].startswith("14.479 um")
    assert (f"setpoint.slew_um_per_ms is {limit:g}, the sine takes 1.98" in criterion[2]) == faster
