"""``micromanip park`` against an emulated device: what it may move, how fast, and what it says of it."""

import json
import os
import re
import time
import uuid
from contextlib import contextmanager

import pytest

from campaigns.bench import Bench, Device
from campaigns.fault_cells import CELLS
from campaigns.running_controller import until
from tests.cli.command import code_of

pytestmark = [pytest.mark.live, pytest.mark.xdist_group("loop")]  # an emulated device goes before ordinary work

SLEW_V_PER_MS = 0.5
GCS_STEP_V, SERIAL_STEP_V = SLEW_V_PER_MS * 10.0, SLEW_V_PER_MS * 0.5
"""What a task at 100 Hz, at 2000 Hz, may move a voltage by at once."""
_RESOLUTION_V = 0.01
AXES = ("voltage_x", "voltage_y", "voltage_z")
NEVER_MS = 1e6
"""A watchdog that does nothing."""


def slow(text):
    """A cell whose voltages move slowly, at rest for a while when a test begins."""
    assert text.count("slew_V_per_ms: 40") == 3
    text = re.sub(r"watchdog: \{ms: 100, .*?\}", "watchdog: {ms: null, after_power_on: last}", text)
    return text.replace("slew_V_per_ms: 40", f"slew_V_per_ms: {SLEW_V_PER_MS}")


@pytest.fixture
def safe_outputs(capsys, monkeypatch):
    """Exit code, standard output and standard error of the command, with the state directory in `state`."""

    def typed(config, state, *arguments):
        monkeypatch.setenv("XDG_STATE_HOME", str(state))
        capsys.readouterr()
        return code_of("park", config, *arguments), *capsys.readouterr()

    return typed


@contextmanager
def device(config):
    """An emulated device at 0 V."""
    emulated = Device(config, uuid.uuid4().hex, NEVER_MS)
    try:
        yield emulated
    finally:
        emulated.end()


@contextmanager
def left_behind(folder, text, changes=None):
    """A device with voltages on it whose controller was killed with all of its processes, after `changes` were set."""
    bench = Bench(folder, text, NEVER_MS)
    try:
        if changes:
            with bench.client() as client:
                until(lambda: client.status()["state"] == "READY", bench.running.last_words)
                client.set(changes)
        bench.track()
        bench.running.kill()
        yield bench
    finally:
        bench.end()


def nothing_comes(bench):
    """For a tenth of a second; what was on the wire when the controller was killed is not what is judged."""
    bench.device.report()
    time.sleep(0.1)
    return not any(each["samples"] for each in bench.device.report()["outputs"].values())


def test_a_park_voltage_that_run_refuses_moves_nothing(tmp_path, safe_outputs):
    config = tmp_path / "cell.yaml"
    config.write_text(CELLS["gcs"]())
    with device(config) as emulated:
        text = config.read_text()
        good = "range_V: [-20, 120], slew_V_per_ms: 40, park_V: 0"
        config.write_text(text.replace(good, "range_V: [-20, 60], slew_V_per_ms: 40, park_V: 110", 1))
        code, out, err = safe_outputs(config, tmp_path)
        outputs = emulated.report()["outputs"]
    assert (code, out) == (78, "")
    assert f"{config}:" in err
    assert "park_V" in err
    assert "nothing was touched: the file can't be used, and no run has left a snapshot" in err
    assert {each["samples"] for each in outputs.values()} == {0}


def test_after_a_run_and_a_typing_error_the_outputs_come_to_park_within_the_slew_limit(tmp_path, safe_outputs):
    slower = {"outputs.voltage_y.slew_V_per_ms": 0.5 * SLEW_V_PER_MS}
    with left_behind(tmp_path / "bench", slow(CELLS["gcs"]()), slower) as bench:
        config, state = bench.running.config, bench.running.folder
        config.write_text(config.read_text().replace("park_V: 0", "park_V: 1100"))
        before = bench.device.report()["outputs"]
        assert max(before[name]["max"] for name in AXES) > 20.0, "there is something to bring to rest"
        (snapshot,) = (state / "micromanip" / "park").iterdir()

        os.chown(snapshot, 4711, 4711)
        code, _, err = safe_outputs(config, state)
        assert code == 78
        assert "belongs to user 4711" in err
        assert {each["samples"] for each in bench.device.report()["outputs"].values()} == {0}

        os.chown(snapshot, 0, 0)
        code, out, err = safe_outputs(config, state, "--json")
        assert (code, err) == (0, "")
        after = bench.device.report()["outputs"]
        for name in AXES:
            assert after[name]["samples"] > 3
            step_V = GCS_STEP_V * (0.5 if name == "voltage_y" else 1.0)
            assert after[name]["largest_step_V"] <= step_V + _RESOLUTION_V
            assert after[name]["min"] == pytest.approx(0.0, abs=_RESOLUTION_V)
        report = json.loads(out)
        assert (report["failed"], report["source"]["file"]) == ([], str(snapshot))

        code, out, err = safe_outputs(config, state)
        assert code == 0
        assert out.startswith("outputs at their safe value: piezo\nas of the run of ")
        again = bench.device.report()["outputs"]
        assert max(again[name]["max"] for name in AXES) == pytest.approx(0.0, abs=_RESOLUTION_V), "no harm twice"

        bench.device.order(inject="gcs_error", driver="piezo", code=5)
        code, out, err = safe_outputs(config, state)
        assert code == 69
        assert "voltage_x (safe: 0 V) can't be called safe: unknown, last 0 V" in err
        assert "at their safe value" not in out


def test_the_feed_stays_held(tmp_path, safe_outputs):
    with left_behind(tmp_path / "bench", slow(CELLS["line"]())) as bench:
        until(lambda: nothing_comes(bench), "the last frames of the killed controller don't end")
        code, out, err = safe_outputs(bench.running.config, bench.running.folder)
        assert (code, err) == (0, ""), err
        assert out.startswith("outputs at their safe value: board\nas of the run of ")
        report = bench.device.report()
    outputs, switches = report["outputs"], report["switches"]
    for name in AXES:
        assert outputs[name]["largest_step_V"] <= SERIAL_STEP_V + _RESOLUTION_V
        assert outputs[name]["min"] == pytest.approx(0.0, abs=_RESOLUTION_V)
    assert (switches["feed_hold"]["min"], switches["feed_hold"]["max"]) == (1, 1), "0 tells the machine to feed"
    assert (switches["amplifier_enable"]["min"], switches["amplifier_enable"]["max"]) == (0, 1), "off in the end"
