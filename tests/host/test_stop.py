"""Stopping on purpose: Ctrl-C, SIGTERM, the duration; each ends with the outputs at park."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest

from micromanip.rt import mailbox as w
from micromanip.rt.phases import PARKING
from micromanip.rt.states import RAMPING
from tests.further import further
from tools.running_controller import as_from_a_terminal, calm, rows_of, simulated, until


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


def test_stall_on_the_way_to_park(run):
    """The loop is late for longer than the whole ramp: the outputs still get to park before OFF, and not in a step."""
    cell = run(calm()).reach("TRACKING")
    interrupt(cell)
    cell.reach("RAMPING")
    until(lambda: rows_of(cell.ring)["phase"][-1] == PARKING, "the correction to be faded out")
    cell.stall(0.7)
    assert_stopped_cleanly(cell)
    rows = rows_of(cell.ring)
    voltage = rows["axis"]["voltage_V"][rows["phase"] == PARKING]
    fastest = 1.875 * voltage.max() / 5000  # of a minimum-jerk course of 0.5 s, a cycle
    assert not rows["axis"]["voltage_V"][-1].any(), f"OFF with {rows['axis']['voltage_V'][-1]} V on the outputs"
    assert np.abs(np.diff(voltage, axis=0)).max() <= 1.1 * fastest


def test_ctrl_c_again_and_again_does_not_cut_the_ramp_short(run):
    cell = run(calm()).reach("TRACKING")
    assert os.getpgid(cell.loop) != cell.process.pid  # the loop is out of Ctrl-C's reach
    interrupt(cell)
    cell.reach("RAMPING")
    interrupt(cell)
    interrupt(cell)
    assert_stopped_cleanly(cell)
    assert cell.status["words"][w.FINISHED] == 1
    rows = rows_of(cell.ring)
    assert np.count_nonzero(rows["state"] == RAMPING) > 1000
    assert not rows["axis"]["voltage_V"][-1].any()
    assert cell.report["recording"] is None


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
    cell = run(calm(), "--record", "run.h5").reach("TRACKING")
    with cell.talk() as idle, cell.talk() as busy, cell.talk() as deaf:
        assert busy.ask(b'{"version": 1, "verb": "status"}')["result"]["state"] == "TRACKING"
        deaf.socket.setblocking(False)
        with suppress(BlockingIOError):  # it asks for more than it reads, and does not hold up the end
            for _ in range(1000):
                deaf.socket.send(b'{"version": 1, "verb": "status"}\n' * 100)
        assert cell.end(signal.SIGTERM) == 0
        assert idle.hear() is None
    assert_stopped_cleanly(cell)
    assert "recorded" in cell.said
    assert "0 lost" in cell.said


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
