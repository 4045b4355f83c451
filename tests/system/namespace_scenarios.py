"""The service under a real systemd: run by the campaign ``systemd`` on a throw-away machine, never on this one."""

import json
import os
import re
import signal
import stat
import subprocess
from pathlib import Path

import numpy as np
import pytest

from campaigns.running_controller import until
from micromanip.rt import mailbox as w
from micromanip.rt.states import RAMPING, TRACKING
from tests.cells import rows_of

from .machine import CONFIG, PROGRAM, UNIT, done, ok

SLEW_V = 4.0  # a cycle, by slew_V_per_ms: 40


def assert_ramped(ring):
    """The outputs went from where they were to park without a step."""
    rows = rows_of(ring)
    voltage = rows["axis"]["voltage_V"]
    assert (rows["state"] == TRACKING).any()
    assert np.count_nonzero(rows["state"] == RAMPING) > 100
    assert np.abs(np.diff(voltage, axis=0)).max() <= SLEW_V
    assert not voltage[-1].any()


def test_starts_to_ready_and_stays_disarmed(service):
    service.start()
    assert ok("systemctl", "is-active", UNIT).strip() == "active"
    assert service.show("StatusText").startswith("READY")
    assert service.state == "READY"
    for pid in service.processes:
        assert Path(f"/proc/{pid}").stat().st_uid == int(ok("id", "-u", "micromanip"))
        assert "CapEff:\t0000000000000000" in Path(f"/proc/{pid}/status").read_text()
    socket = Path("/run/micromanip/control.sock")
    assert stat.S_IMODE(socket.stat().st_mode) == 0o660
    assert socket.group() == "micromanip"


def test_operators_may_and_strangers_may_not(service):
    service.start()
    assert json.loads(ok(PROGRAM, "status", "--json", user="cell-operator"))["state"] == "READY"
    refused = done(PROGRAM, "arm", user="passer-by")
    assert refused.returncode == 77
    assert refused.stderr.count("\n") == 1
    assert "your user must be in the controller's group" in refused.stderr
    assert service.state == "READY"


def test_the_audit_trail_names_who_asked(service):
    service.start()
    ok(PROGRAM, "arm", user="cell-operator")
    ok(PROGRAM, "disarm")
    armed, disarmed = json.loads(ok(PROGRAM, "log", "--last", "2", "--json"))["entries"]
    assert (armed["verb"], armed["user"], armed["uid"]) == (
        "arm",
        "cell-operator",
        int(ok("id", "-u", "cell-operator")),
    )
    assert (disarmed["verb"], disarmed["user"], disarmed["uid"]) == ("disarm", "root", 0)


@pytest.fixture
def configured(service):
    """Gives the installed configuration a section `control`; it is as before at the end."""
    text = CONFIG.read_text()
    assert "control:" not in text
    yield lambda section: CONFIG.write_text(f"{text}\ncontrol: {section}\n")
    CONFIG.write_text(text)


def test_one_group_operates_and_another_observes(service, configured):
    """Neither is a group of the controller's user, and its own group is not let in any more."""
    configured("{operate_group: runs-it, observe_group: looks-on}")
    service.start()
    assert json.loads(ok(PROGRAM, "status", "--json", user="looks-on"))["state"] == "READY"
    ok(PROGRAM, "get", "axes.x.mode", user="looks-on")
    for refused in (("arm",), ("set", "axes.x.authority_percent=50"), ("disarm",), ("save",), ("reload",)):
        outcome = done(PROGRAM, *refused, user="looks-on")
        assert outcome.returncode == 77
        assert f"{refused[0]} refused: looks-on may only observe" in outcome.stderr
    for stranger in ("passer-by", "cell-operator"):
        assert done(PROGRAM, "status", user=stranger).returncode == 77
    assert service.state == "READY"
    ok(PROGRAM, "arm", user="runs-it")
    service.reach("TRACKING")
    trail = json.loads(ok(PROGRAM, "log", "--json", user="looks-on"))["entries"]
    assert [(e["user"], e["verb"], e["accepted"]) for e in trail[-6:]] == [
        *(("looks-on", verb, False) for verb in ("arm", "set", "disarm", "save", "reload")),
        ("runs-it", "arm", True),
    ]


def test_a_link_that_an_operator_has_planted_is_not_followed(service, tmp_path):
    """The folder of the configuration is the group's: installing replaces what lies there, and follows it nowhere."""
    text, before = CONFIG.read_text(), Path("/etc/shadow").read_bytes()
    (tmp_path / "mine.yaml").write_text(text)
    ok("ln", "-sf", "/etc/shadow", str(CONFIG), user="cell-operator")
    ok("ln", "-sf", "/etc/shadow", f"{CONFIG}.new", user="cell-operator")
    ok(PROGRAM, "system", "install", str(tmp_path / "mine.yaml"), "--yes")
    ok("rm", f"{CONFIG}.new")
    assert Path("/etc/shadow").read_bytes() == before
    assert not CONFIG.is_symlink()
    assert CONFIG.read_text() == text
    assert (CONFIG.owner(), CONFIG.group(), stat.S_IMODE(CONFIG.stat().st_mode)) == ("root", "micromanip", 0o660)


def test_stop_ramps_down_first(service):
    service.start().track()
    ok("systemctl", "stop", UNIT)
    assert service.show("Result") == "success"
    assert service.show("ExecMainStatus") == "0"
    assert service.status["words"][w.FINISHED] == 1
    assert_ramped(service.ring)
    assert not Path("/run/micromanip").exists()


def test_killed_host_leaves_a_loop_that_ramps_and_is_started_again_disarmed(service):
    service.start().track()
    ring, status, processes = service.ring, service.status, service.processes
    os.kill(service.host, signal.SIGKILL)
    until(lambda: status["words"][w.FINISHED] == 1, lambda: f"end of the loop\n{service.journal()}", 30.0)
    assert_ramped(ring)
    service.restarted()
    assert service.show("Result") == "success"  # of the new run
    assert service.state == "READY"
    assert not set(processes) & set(service.processes)
    service.track()


def test_stuck_host_is_ended_by_the_watchdog(service):
    service.start().track()
    ring = service.ring
    os.kill(service.host, signal.SIGSTOP)
    service.restarted()
    assert "Watchdog timeout" in service.journal()
    assert_ramped(ring)
    assert service.state == "READY"


def test_stuck_loop_is_ended_by_the_host(service):
    service.start().track()
    os.kill(service.loop, signal.SIGSTOP)
    service.restarted()
    assert "X-105 the loop has stood still for " in service.journal()
    entry = json.loads(ok("journalctl", "--output=json", "--lines=1", "MICROMANIP_CODE=X-105"))
    assert entry["PRIORITY"] == "2"  # as every trip
    assert entry["_SYSTEMD_UNIT"] == UNIT
    assert "driver cell: outputs at their safe value" in service.journal()
    assert "Watchdog timeout" not in service.journal()
    assert service.state == "READY"


def test_both_killed_are_followed_by_safe_outputs(service):
    service.start().track()
    os.kill(service.loop, signal.SIGKILL)
    os.kill(service.host, signal.SIGKILL)
    service.restarted()
    assert "outputs at their safe value: cell" in service.journal()
    assert service.state == "READY"


def test_wrong_configuration_is_not_tried_again(service):
    text = CONFIG.read_text()
    CONFIG.write_text(text.replace("rate_hz: 10000", "rate_hz: fast"))
    try:
        assert done("systemctl", "start", UNIT).returncode != 0
        until(lambda: service.show("ActiveState") == "failed", service.journal, 30.0)
    finally:
        CONFIG.write_text(text)
    assert service.show("ExecMainStatus") == "78"
    assert service.show("NRestarts") == "0"
    assert f"micromanip: {CONFIG}:" in service.journal()
    assert "loop.rate_hz" in service.journal()
    until(lambda: "outputs at their safe value: cell" in service.journal(), service.journal, 10.0)
    assert "as of the run of" in service.journal(), "by what ran before"


def test_reload_keeps_everything_running(service):
    service.start().track()
    host, cycles = service.host, service.status["words"][w.CYCLES_RUN]
    ok("systemctl", "reload", UNIT)
    until(lambda: "reloaded, changed: nothing" in service.journal(), service.journal, 5.0)
    until(lambda: service.show("ActiveState") == "active", "active", 5.0)
    assert int(service.show("MainPID")) == host
    assert service.state == "TRACKING"
    assert service.status["words"][w.CYCLES_RUN] > cycles


def test_one_controller_a_device(service):
    service.start().track()
    second = done(PROGRAM, "run", str(CONFIG), "--socket", "/tmp/second.sock", user="cell-operator")
    assert second.returncode == 69
    user = Path(f"/proc/{service.host}").stat().st_uid
    assert second.stderr == (
        f"micromanip: device bench is in use by another controller (process {service.host} of user {user}, `systemctl "
        "stop micromanip.service`, or the loop that it left); stop it first\n"
    )
    refused = done(PROGRAM, "park", str(CONFIG), user="cell-operator")
    assert refused.returncode == 1
    assert "nothing was touched: device bench is in use" in refused.stderr
    assert service.state == "TRACKING"
    ok("systemctl", "stop", UNIT)
    ok(PROGRAM, "park", str(CONFIG), user="cell-operator")
    for asks in ("cell-operator", "root"):
        assert "as of the run of" in ok(PROGRAM, "park", str(CONFIG), user=asks), "by what the service has left"


def test_page_can_be_followed_as_written(service, tmp_path):
    """Every command of docs/operate.md in its order, on an installed cell; but for pip, which was done before."""
    text = (Path(__file__).parents[2] / "docs" / "operate.md").read_text()
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines() if "pip install" not in line]
    assert len(lines) > 20
    (tmp_path / "mine.yaml").write_text(CONFIG.read_text())
    (tmp_path / "sudo").write_text('#!/bin/sh\nexec "$@"\n')  # the test is root already
    (tmp_path / "sudo").chmod(0o755)
    (tmp_path / "micromanip").symlink_to(PROGRAM)
    environment = os.environ | {"PATH": f"{tmp_path}:/usr/local/bin:{os.environ['PATH']}", "USER": "passer-by"}
    for line in lines:
        outcome = subprocess.run(
            ["bash", "-ec", line], capture_output=True, text=True, cwd=tmp_path, env=environment, check=False
        )
        assert outcome.returncode == 0, f"{line}\n{outcome.stdout}{outcome.stderr}\n{service.journal()}"
    ok(PROGRAM, "system", "install", "--uninstall", "--purge", "--yes")
    ok(PROGRAM, "system", "install", str(tmp_path / "mine.yaml"), "--yes")


def test_uninstall_keeps_what_is_yours_and_purge_does_not(service):
    service.start()
    service.release()
    assert done("systemctl", "is-enabled", UNIT).stdout.strip() == "enabled"
    ok(PROGRAM, "system", "install", "--uninstall", "--yes")
    assert done("systemctl", "is-active", UNIT).stdout.strip() == "inactive"
    assert not Path("/etc/systemd/system/multi-user.target.wants/micromanip.service").is_symlink()
    assert CONFIG.is_file()
    assert Path("/var/lib/micromanip").is_dir()
    ok(PROGRAM, "system", "install", "--uninstall", "--purge", "--yes")
    assert not CONFIG.parent.exists()
    assert not Path("/var/lib/micromanip").exists()
    assert not Path("/var/cache/micromanip").exists()
    assert done("id", "micromanip").returncode != 0
    assert ok(PROGRAM, "system", "install", "--uninstall", "--purge").startswith("nothing to do")
