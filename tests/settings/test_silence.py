"""A loop that is only late must keep the outputs of its buses: `faults.link.loop_silent_ms` against its period."""

import pytest

from campaigns.fault_cells import patient_can_cell
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare

STANDS = "reference: {source: hold, offset_um: 60}"


def complaint(folder, faults):
    (folder / "cell.yaml").write_text(patient_can_cell().replace(STANDS, f"faults: {faults}\n{STANDS}"))
    with pytest.raises(ConfigError) as caught:
        prepare(folder / "cell.yaml")
    return str(caught.value)


def test_a_time_of_few_periods_is_refused_with_its_place(tmp_path):
    said = complaint(tmp_path, "{link: {loop_silent_ms: 9.9}}")
    assert "cell.yaml:23: faults.link.loop_silent_ms: 9.9 ms are 4.95 periods of the loop" in said
    assert said.endswith("give it 10 ms or more (5 periods)")


def test_a_stall_that_is_answered_by_a_hold_must_not_cost_the_outputs(tmp_path):
    said = complaint(tmp_path, "{deadline: {in_a_row: 20}, link: {loop_silent_ms: 43}}")
    assert said.endswith("give it 44 ms or more (22 periods, as faults.deadline.in_a_row is 20)")


@pytest.mark.parametrize(
    "faults", ["{link: {loop_silent_ms: 10}}", "{deadline: {in_a_row: 20}, link: {loop_silent_ms: 44}}"]
)
def test_the_least_times_are_good(tmp_path, faults):
    (tmp_path / "cell.yaml").write_text(patient_can_cell().replace(STANDS, f"faults: {faults}\n{STANDS}"))
    prepare(tmp_path / "cell.yaml")
