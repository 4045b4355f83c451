"""The benchmarks measure what they say: the C twin does our cycle's work, and what can't run here is named."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from micromanip.cli.bench import source_tree
from micromanip.cli.main import cli
from micromanip.errors import CheckFailed, DeviceUnavailable
from micromanip.rt.records import INPUT_HISTORY
from micromanip.rt.states import ARMED, FAULT, OFF, RAMPING, READY, RESET, STAGE_INVALID, STOP, TRACKING
from micromanip.settings.check import prepare

pytestmark = pytest.mark.compiled_only
CONFIGURATION = source_tree() / "config" / "simulated.yaml"
TRACKING_CYCLES = 2000
KEYS = {"name", "value", "unit", "reference_name", "reference_value", "ratio"}


@pytest.fixture(scope="module")
def recording():
    from benchmarks.recording import record_arming

    return record_arming(prepare(CONFIGURATION), TRACKING_CYCLES)


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    from benchmarks.recording import twin_player
    from benchmarks.results import Skipped

    try:
        return twin_player(tmp_path_factory.mktemp("twin"))
    except Skipped as reason:
        pytest.skip(str(reason))


@pytest.fixture
def agreed(twin):
    """Replays a recording both ways, demands agreement, returns our outcome."""
    from benchmarks.agreement import require_agreement
    from benchmarks.recording import Outcome, ours

    def replay(recording):
        left, right = (Outcome.room(len(recording.signals)) for _ in range(2))
        ours(recording, left, 1)
        twin(recording, right, 1)
        require_agreement(left, right)
        return left

    return replay


def bench(*arguments):
    """The command in a process of its own."""
    command = [sys.executable, "-c", "from micromanip.cli.main import main; main()", "bench", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def channel(recording, role):
    """Index of the signal of axis x."""
    return int(recording.parameters[0]["axis"][0][role])


def test_twin_agrees_through_arming_and_tracking(recording, agreed):
    rows = agreed(recording).rows
    assert list(rows["state"][[0, -TRACKING_CYCLES - 1, -TRACKING_CYCLES, -1]]) == [READY, ARMED, TRACKING, TRACKING]
    assert np.ptp(rows["axis"]["voltage_V"][-TRACKING_CYCLES:, 0]) > 1.0


def test_twin_agrees_on_late_missing_and_false_samples_and_overruns(recording, agreed):
    """Sensors that report late, rarely, not at all for a while, or nonsense; some periods are skipped."""
    random = np.random.default_rng(4)
    cycles = len(recording.signals)
    start = cycles - TRACKING_CYCLES
    signals, parameters, periods = recording.signals.copy(), recording.parameters.copy(), recording.periods.copy()
    for role in ("strain", "stage", "deviation"):
        place = channel(recording, role)
        late = np.maximum.accumulate(np.maximum(np.arange(cycles) - random.integers(0, 12, cycles), 0))
        held = np.arange(cycles) // 3 * 3
        signals[:, place] = recording.signals[late[held], place]
        signals["value"][random.integers(start, cycles, 40), place] = np.nan
        signals["value"][random.integers(start, cycles, 40), place] = random.choice([-1e6, 1e6], 40)
        signals["status"][random.integers(start, cycles, 40), place] = 1
        signals["time_ns"][:, place] -= random.integers(0, 99_000, cycles)
        signals[-1500:-1100, place] = signals[-1500, place]
    signals[:5] = 0
    for age in ("strain_age_ns", "stage_age_ns", "reference_age_ns"):
        parameters["axis"][age] = np.iinfo(np.int64).max
    parameters["bad_samples"], parameters["score_cycles"] = cycles, TRACKING_CYCLES // 2
    periods[random.integers(start, cycles, 30)] += random.integers(1, 4, 30)
    periods[-200] = 2 * INPUT_HISTORY
    outcome = agreed(replace(recording, parameters=parameters, signals=signals, periods=periods))
    axis = outcome.rows["axis"][:, 0]
    assert outcome.rows["state"][-1] == TRACKING
    assert axis["stage_age_ns"].max() > 10_000_000
    assert 0.1 < np.mean(axis["fresh"][start:] & 2 > 0) < 0.5
    assert outcome.state["axis"]["reference"]["rejected"][0, 0] > 0
    assert outcome.state["axis"]["errors"][0, 0] > 0


@pytest.mark.parametrize(("command", "after"), [(RESET, READY), (STOP, OFF)])
def test_twin_agrees_where_a_stale_sensor_trips_the_cell(recording, agreed, command, after):
    signals, commands, parameters = recording.signals.copy(), recording.commands.copy(), recording.parameters.copy()
    place = channel(recording, "stage")
    dead = -TRACKING_CYCLES + 50
    parameters["ramp_cycles"] = 500
    signals[dead:, place] = signals[dead, place]
    commands[dead + (550 if command == RESET else 300)] = command
    rows = agreed(replace(recording, parameters=parameters, signals=signals, commands=commands)).rows
    assert list(rows["state"][[dead + 10, dead + 540, -1]]) == [RAMPING, FAULT if command == RESET else OFF, after]
    assert rows["fault"][dead + 10] == STAGE_INVALID


def test_disagreement_names_the_number(recording):
    from benchmarks.agreement import require_agreement
    from benchmarks.recording import Outcome, ours

    short = replace(recording, signals=recording.signals[:200])
    left, right = Outcome.room(200), Outcome.room(200)
    ours(short, left, 1)
    ours(short, right, 1)
    right.rows["axis"]["voltage_V"][7, 1] += 1e-6
    with pytest.raises(CheckFailed, match=r"rows\.axis\.voltage_V at \[7, 1\]"):
        require_agreement(left, right)


def test_twin_refuses_a_law_that_it_lacks(recording):
    from benchmarks.twin import require_covered

    parameters = recording.parameters.copy()
    parameters["axis"][0, 1]["feedback"] = 0
    with pytest.raises(CheckFailed, match="covers"):
        require_covered(parameters)


def test_json_is_one_document():
    done = bench("--json", "--only", "offline")
    assert done.returncode == 0
    document = json.loads(done.stdout)
    assert [row["name"] for row in document["results"]] == ["offline"]
    assert set(document["results"][0]) == KEYS
    assert document["skipped"] == []
    assert "offline" in done.stderr


def test_what_this_machine_lacks_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "")
    arguments = ["bench", "--json", "--only", "lateness", "--only", "cycle"]
    document = json.loads(CliRunner().invoke(cli, arguments, catch_exceptions=False).stdout)
    assert document["results"] == []
    assert {entry["name"]: entry["reason"].rsplit(" ", 1)[1] for entry in document["skipped"]} == {
        "cycle": "gcc",
        "lateness": "rt-tests",
    }


def test_unknown_benchmark_is_wrong_usage():
    done = bench("--only", "speed")
    assert done.returncode == 64
    assert "cycle, lateness, offline, startup" in done.stderr


def test_outside_the_source_tree_it_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr("micromanip.__file__", str(tmp_path / "micromanip" / "__init__.py"))
    with pytest.raises(DeviceUnavailable, match="source tree"):
        source_tree()
    assert DeviceUnavailable.exit_code == 69
