"""Any process may die or stall: the outputs go smoothly to park, nobody hides it, nothing is left."""

import os
import signal
import time

import numpy as np
import pytest
from micromanip_drivers.simulated.records import CONTEXT

from campaigns.running_controller import descriptor_of, until
from micromanip.host.shared_memory import Segment
from micromanip.host.trips.store import TripRecord, trips
from micromanip.rt import mailbox as w
from micromanip.rt.states import FAULT, HOLDING, HOST_DEAD, OFF, OVERRUNS, RAMPING, TRACKING
from tests.cells import LEISURELY, SLOW, WAITING, calm, changed, rows_of

from .black_boxes import assert_whole, box_of, explained, folder

SLEW_V = 4.0  # 40 V/ms, a cycle
RAMP_CYCLES, PERIOD_MS = 5000, 0.1


def assert_smooth_ramp(rows, park_V=0.0):
    """Held, then the minimum-jerk course to park: no step, no detour."""
    held = rows[np.flatnonzero(rows["state"] == TRACKING)[-1] :]
    ramp = held[np.flatnonzero(held["state"] == HOLDING)[-1] :]
    assert set(held["state"][1 : -len(ramp)]) == {HOLDING}
    assert np.ptp(held["axis"]["setpoint_um"][: -len(ramp)], axis=0).max() < 1.0
    assert set(ramp["state"][1:-1]) == {RAMPING}
    assert ramp["state"][-1] == OFF
    assert len(ramp) == pytest.approx(RAMP_CYCLES, abs=4)  # cycles that were run: the ramp waits while the loop is late
    for i in range(3):
        voltage = ramp["axis"]["voltage_V"][:, i]
        stroke = abs(voltage[0] - park_V)
        assert stroke > 20.0  # the loop really was up
        fastest = 1.875 * stroke / RAMP_CYCLES  # of a minimum-jerk course, a period
        assert np.abs(np.diff(voltage)).max() <= 1.05 * fastest < SLEW_V
        assert (np.diff(voltage) * np.sign(park_V - voltage[0]) >= 0).all()
        assert voltage[-1] == park_V


def test_host_killed_while_tracking(run):
    cell = run(calm()).reach("TRACKING")
    until(lambda: cell.child("trips.process"), cell.last_words)
    cell.go_on(5000)
    cell.process.kill()
    assert cell.wait() == -signal.SIGKILL
    cell.gone()  # the loop ends by itself, and takes the socket's file with it
    assert not cell.socket.exists()
    assert cell.state == "OFF"
    assert cell.status["words"][w.FINISHED] == 1
    rows = rows_of(cell.ring)
    assert rows["fault"][-1] == HOST_DEAD
    assert_smooth_ramp(rows)
    box = box_of(cell)  # finished without the host
    assert box.trip["code"] == "X-101"
    assert box.rows["fault"][-1] == box.trip["number"]
    assert_whole(box, min(2000.0, (box.trip["cycle"] - 1) * PERIOD_MS), min(500.0, cell.cycles * PERIOD_MS))
    assert "X-101 no sign of life" in explained(cell)
    silent_s = (rows["time_ns"][rows["fault"] == HOST_DEAD][0] - cell.control["words"][w.HEARTBEAT_NS]) * 1e-9
    assert silent_s >= 0.999  # it is not given up sooner than its limit


def test_the_whole_machine_stalls(run):
    """A virtual machine is paused; the loop wakes up late, the host later still: there is no step all the same."""
    cell = run(calm()).reach("TRACKING")
    loop = cell.loop
    os.kill(loop, signal.SIGSTOP)
    os.kill(cell.process.pid, signal.SIGSTOP)
    try:
        heard_ns = int(cell.control["words"][w.HEARTBEAT_NS])
        until(lambda: time.monotonic_ns() - heard_ns > 1_500_000_000, "the time to pass")
        os.kill(loop, signal.SIGCONT)
        until(lambda: cell.state == "OFF", lambda: f"the loop's end without its host, it is {cell.state}")
    finally:
        os.kill(loop, signal.SIGCONT)
        os.kill(cell.process.pid, signal.SIGCONT)
    assert cell.wait() == 1
    assert "X-101 no sign of life from the host" in cell.said
    assert_smooth_ramp(rows_of(cell.ring))


def test_loop_killed_while_tracking(run):
    cell = run(calm()).reach("TRACKING")
    context = Segment.attach(descriptor_of(cell.process.pid, "micromanip-contexts"), writable=False)
    try:
        driver = context.record(CONTEXT)
        assert driver["s"]["latched_V"].min() > 20.0
        cell.go_on(5000)
        os.kill(cell.loop, signal.SIGKILL)
        assert cell.wait() == 1
        lines = [line for line in cell.said.splitlines() if "X-104" in line]
        assert len(lines) == 1
        assert "X-104 the loop process was killed by signal 9. Likely: " in lines[0]
        assert "driver cell: outputs at their safe value" in cell.said
        assert driver["safe"] == 1
        assert not driver["s"]["latched_V"].any()
    finally:
        os.close(context.descriptor)
    assert cell.report.keys() == {"error", "exit_code"}  # no report is better than half of one
    assert "Traceback" not in cell.said
    cell.gone()
    box = box_of(cell)
    assert box.trip["code"] == "X-104"
    assert "was killed by signal 9" in box.trip["message"]
    assert f"Black box: {trips(folder(cell))[0]}" in cell.said
    head = cell.ring["rows"]["cycle"].max()
    assert box.rows["cycle"][-1] == head  # up to the last one it ran
    assert_whole(box, min(2000.0, (head - 1) * PERIOD_MS), 0.0)
    assert "X-104" in explained(cell)


def test_loop_that_stands_still(run):
    """Alive, but it does not turn: ended by the host, outputs brought to their safe value."""
    cell = run(LEISURELY).reach("TRACKING")
    os.kill(cell.loop, signal.SIGSTOP)
    assert cell.wait() == 1
    lines = [line for line in cell.said.splitlines() if "X-105" in line]
    assert len(lines) == 1
    assert "X-105 the loop has stood still for " in lines[0]
    assert "X-104" not in cell.said  # it was no accident
    (file,) = trips(folder(cell))
    assert "Black box: " in cell.said
    assert TripRecord.load(file).trip["code"] == "X-105"
    assert "driver cell: outputs at their safe value" in cell.said
    cell.gone()


def test_both_killed(run):
    """Nothing but memory without a name, which the kernel takes back; the stale socket is replaced later.

    Nobody tells the black box of it: that no cycle passes any more tells enough.
    """
    cell = run(changed(LEISURELY, *WAITING)).reach("READY")
    until(lambda: cell.child("trips.process"), cell.last_words)
    cell.go_on(100)
    loop = cell.loop
    os.kill(loop, signal.SIGSTOP)  # or it would see the host's death and end in order
    cell.process.kill()
    os.kill(loop, signal.SIGKILL)
    cell.wait()
    cell.gone()
    assert box_of(cell).trip["code"] == "X-104"
    assert cell.socket.is_socket()  # stale: nobody was left to remove it
    again = run(changed(LEISURELY, *WAITING), "--socket", str(cell.socket)).reach("READY")
    assert again.end() == 0
    assert not cell.socket.exists()


@pytest.mark.realtime  # another stall of 15 ms is a fault before its time
def test_stall_is_latched_under_hardware_limits(run):
    """Three missed deadlines in a row, by one long stall: ramp down, FAULT, exit 1 with X-102."""
    cell = run(SLOW).reach("TRACKING")  # 200 Hz: what a noisy machine does by itself is no overrun
    cell.stall(0.1)
    cell.reach("FAULT")
    cell.go_on(50)
    assert cell.state == "FAULT"  # latched
    rows = rows_of(cell.ring)
    late = int(np.flatnonzero(rows["periods"] > 3)[0])
    assert rows["state"][late - 1] == TRACKING
    assert rows["state"][late] == HOLDING  # in that very cycle
    assert (rows["fault"][late:] == OVERRUNS).all()
    after = rows[late:]["state"]
    assert list(after[np.flatnonzero(np.diff(after, prepend=-1))]) == [HOLDING, RAMPING, FAULT]
    voltage = rows["axis"]["voltage_V"][late - 1 :, 0]
    assert voltage[0] == pytest.approx(60.0)
    assert np.abs(np.diff(voltage)).max() <= 1.05 * 1.875 * 60.0 / 40  # 0.2 s are 40 cycles: no step after the stall
    assert voltage[-1] == 0.0
    assert cell.end() == 1
    assert cell.report["state"] == "OFF"
    (fault,) = cell.report["faults"]
    assert fault.startswith(f"X-102 {rows['periods'][late] - 1} deadlines missed (limit 3). ")
    said = " ".join(cell.said.split())
    assert said.count(fault) == 1, "told once"
    assert "micromanip: ended by X-102, as said above" in said
