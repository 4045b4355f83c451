"""Stopping on purpose: Ctrl-C, SIGTERM, the duration; each ends with the outputs at park."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest

from campaigns.running_controller import as_from_a_terminal, until
from micromanip.rt import mailbox as w
from micromanip.rt.states import PARKING, RAMPING
from tests.cells import Talk, calm, rows_of, simulated
from tests.further import further

from .recorded import recorded_rows, recording_of

SLEW_V = 4.0  # 40 V/ms, a cycle


def interrupt(cell):
    """Ctrl-C as a terminal sends it: to the whole foreground process group."""
    os.killpg(cell.process.pid, signal.SIGINT)


def assert_stopped_cleanly(cell):
    assert cell.wait() == 0, cell.said
    assert cell.report["state"] == "OFF"
    assert cell.report["faults"] == []
    assert "Traceback" not in cell.said
    cell.gone()
    assert not cell.socket.exists()


def test_a_stall_is_counted_and_told_under_simulation_limits_and_neither_another_nor_ctrl_c_cuts_the_ramp_short(run):
    """The loop is late for longer than the whole ramp: the outputs still get to park before OFF, and not in a step."""
    cell = run(calm()).reach("TRACKING")
    before = int(cell.status["words"][w.OVERRUNS])
    cell.stall(0.05)
    cell.go_on(3000)
    assert cell.state == "TRACKING"
    rows = rows_of(cell.ring)
    late = rows[np.argmax(rows["periods"])]
    assert late["periods"] > 300
    assert late["lateness_ns"] > 30_000_000
    assert rows["axis"]["voltage_V"].min() >= -20.0
    assert rows["axis"]["voltage_V"].max() <= 150.0
    assert np.abs(np.diff(rows["axis"]["voltage_V"], axis=0)).max() <= SLEW_V * (1 + 1e-9)
    assert cell.status["words"][w.OVERRUNS] - before >= late["periods"] - 1
    assert (np.diff(rows["cycle"]) == rows["periods"][1:]).all()  # the missed cycles are skipped, not made up

    assert os.getpgid(cell.loop) != cell.process.pid  # the loop is out of Ctrl-C's reach
    interrupt(cell)
    cell.reach("RAMPING")
    interrupt(cell)
    interrupt(cell)
    until(lambda: rows_of(cell.ring)["phase"][-1] == PARKING, "the correction to be faded out")
    cell.stall(0.7)
    assert_stopped_cleanly(cell)
    assert cell.status["words"][w.FINISHED] == 1
    rows = rows_of(cell.ring)
    assert np.count_nonzero(rows["state"] == RAMPING) > 1000
    voltage = rows["axis"]["voltage_V"][rows["phase"] == PARKING]
    fastest = 1.875 * voltage.max() / 5000  # of a minimum-jerk course of 0.5 s, a cycle
    assert not rows["axis"]["voltage_V"][-1].any(), f"OFF with {rows['axis']['voltage_V'][-1]} V on the outputs"
    assert np.abs(np.diff(voltage, axis=0)).max() <= 1.1 * fastest
    assert cell.report["recording"] is None
    assert cell.report["overruns"] >= late["periods"] - 1
    assert cell.report["lateness_ns"]["max"] >= late["lateness_ns"]


@pytest.mark.parametrize("state", ["ARMING", *further("READY")])
def test_ctrl_c_before_tracking(run, state):
    arm = str(state == "ARMING").lower()
    cell = run(simulated(("arm_on_start: true", f"arm_on_start: {arm}"))).reach(state)
    interrupt(cell)
    assert_stopped_cleanly(cell)


def test_ctrl_c_while_the_loop_is_coming_up(run):
    cell = run(calm())
    until(cell.socket.exists, cell.last_words)  # the configuration is read, and the loop has its orders soon
    interrupt(cell)
    assert_stopped_cleanly(cell)


def test_ctrl_c_before_the_configuration_is_read(run):
    """The loop process imports by then, and goes with its host: it never had orders."""
    cell = run(calm())
    until(lambda: cell.child("loop_process"), cell.last_words)
    interrupt(cell)
    if cell.wait() == 0:  # it was read by then
        assert_stopped_cleanly(cell)
    else:
        assert (cell.process.returncode, cell.said.strip()) == (130, "")
        assert not cell.socket.exists()
    cell.gone()


def test_sigterm_with_a_recording_and_clients_on_the_line(run):
    """`status` and the report at the end tell how far the recording is."""
    cell = run(calm(), "--record", "run.mcap").reach("TRACKING")
    until(lambda: recording_of(cell)["rows"] > 1000, cell.last_words)
    found = recording_of(cell)
    assert (found["file"], found["state"], found["message"]) == ("run.mcap", "recording", None)
    with Talk(cell.socket) as idle, Talk(cell.socket) as busy, Talk(cell.socket) as deaf:
        assert busy.ask(b'{"version": 1, "verb": "status"}')["result"]["state"] == "TRACKING"
        deaf.socket.setblocking(False)
        with suppress(BlockingIOError):  # it asks for more than it reads, and does not hold up the end
            for _ in range(1000):
                deaf.socket.send(b'{"version": 1, "verb": "status"}\n' * 100)
        assert cell.end(signal.SIGTERM) == 0
        assert idle.hear() is None
    assert_stopped_cleanly(cell)
    found, rows = cell.report["recording"], recorded_rows(cell.folder / "run.mcap")
    assert f"recorded {len(rows)} cycles to run.mcap, {found['dropped']} lost" in cell.said
    assert (found["state"], found["message"]) == ("complete", None)
    assert found["rows"] == len(rows)
    assert bool(found["dropped"]) == bool(np.sum(np.diff(rows["cycle"]) - rows["periods"][1:]))


SWALLOWED = """
import os, signal, sys, time
import micromanip.settings.check as check
prepare = check.prepare
def prepared(file):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)
    except KeyboardInterrupt:
        print("swallowed")
    return prepare(file)
check.prepare = prepared
from micromanip.cli.main import main
main(sys.argv[1:])
"""


def test_ctrl_c_that_an_import_swallows_is_heeded_all_the_same(tmp_path):
    """Once in 80 starts what was raised while modules were made was lost, and the cell went on to arm."""
    config = tmp_path / "cell.yaml"
    config.write_text(calm())
    command = [sys.executable, "-c", SWALLOWED, "run", str(config), "--socket", str(tmp_path / "s"), "--duration", "1"]
    how = {"capture_output": True, "text": True, "timeout": 120, "cwd": tmp_path, "preexec_fn": as_from_a_terminal}
    done = subprocess.run(command, **how)
    assert done.stdout == "swallowed\n"
    assert (done.returncode, "READY" in done.stderr) == (130, False)
