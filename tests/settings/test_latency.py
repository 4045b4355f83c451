"""Samples of a tracker that may be older than the loop can do without one: told, and the advice is right."""

import pytest

from campaigns.report import CONFIG
from micromanip.rt.states import NO_FAULT, REFERENCE_LOST, TRACKING
from micromanip.settings.check import prepare
from micromanip.settings.checks.ranges import latency_warnings
from micromanip.virtual.cell import VirtualCell

SIMULATED = CONFIG / "simulated.yaml"
AT_S, SILENT_S = 4.037, 0.04
"""In this time the path moves further than a tracker may jump."""
SILENT = "    seed: 1\n    faults:\n" + "".join(
    f"      - {{at_s: {AT_S}, for_s: {SILENT_S}, channel: deviation_{axis}, kind: drop}}\n" for axis in "xyz"
)
OLD = ("max_age_us: 3000}", "max_age_us: 50000}")


def cell(folder, *changes):
    """The example with `changes` of its text, its tracker silent for 40 ms."""
    text = SIMULATED.read_text(encoding="utf-8").replace("    seed: 1\n", SILENT, 1)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    return prepare(file)


def horizon(ms):
    return "  sample_rate_Hz: 1000\n", f"  sample_rate_Hz: 1000\n  horizon_ms: {ms}\n"


def ended(prepared):
    """State and fault after the silence."""
    tracking = VirtualCell(prepared.parameters, prepared.wiring)
    tracking.arm()
    tracking.run(AT_S + 0.6 - float(tracking.state[0]["cycle"]) * 1e-4)
    return int(tracking.state[0]["state"]), int(tracking.state[0]["fault"])


@pytest.mark.long
def test_samples_older_than_the_horizon_end_a_healthy_cell_and_what_is_advised_does_not(tmp_path):
    warned = cell(tmp_path, OLD)
    line = next(i for i, text in enumerate(warned.source.text.splitlines(), 1) if text == "reference:")
    assert warned.warnings == [
        f"{tmp_path}/cell.yaml:{line}: reference.horizon_ms: 20 ms are less than the 50 ms that a sample of the "
        "tracker may be old (max_age_us): a path that has moved by more than jump_um, 50 um, when one comes later is "
        "taken for a jump and lost; write 50, or max_age_us: 20000"
    ]
    assert ended(warned)[1] == REFERENCE_LOST
    advised = cell(tmp_path, OLD, horizon(50))
    assert advised.warnings == []
    assert ended(advised) == (TRACKING, NO_FAULT)


def test_a_fault_that_comes_before_a_sample_is_too_old_is_told(tmp_path):
    early = cell(tmp_path, OLD, horizon(50), ("  limits: simulation", "  limits: hardware"))
    assert [(path, text.split(";")[1]) for path, text in latency_warnings(early.configuration)] == [
        (("axes", axis, "faults", "reference", "time_ms"), " write 50, or max_age_us: 20000") for axis in "xyz"
    ]


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (("max_age_us: 3000}", "max_age_us: 20000}"),),
        (("max_age_us: 3000}", "max_age_us: null}"),),
        (OLD, ("  sample_rate_Hz: 1000\n", "  sample_rate_Hz: 1000\n  jump_um: null\n")),
        (OLD, ("  sample_rate_Hz: 1000\n", "  sample_rate_Hz: 1000\n  range_um: [-20, 20]\n")),
    ],
    ids=["as it is", "as old as the horizon", "without a limit", "without a jump", "range within a jump"],
)
def test_nothing_is_told_where_nothing_is_lost(tmp_path, changes):
    assert list(latency_warnings(cell(tmp_path, *changes).configuration)) == []


def test_an_age_that_the_file_says_nothing_of_follows_from_rate_and_way(tmp_path):
    """Two samples in a row may be lost, of a bus at 500 Hz whose device takes 1 ms to answer; what is given stays."""
    said = "strain_x, max_age_us: 50000"
    text = (SIMULATED.parent / "modbus.yaml").read_text()
    assert said in text
    text = text.replace(said, "strain_x")
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    signals = prepare(file).configuration.signals
    assert signals["strain_x"].max_age_us == pytest.approx(3 * 2000 + 1000, rel=0.1)
    assert signals["strain_y"].max_age_us == 50_000
