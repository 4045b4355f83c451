"""The gateway's unit under a real systemd: run by the campaign ``systemd``, on a throw-away machine."""

import json
import stat
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from campaigns.running_controller import until

from .machine import PROGRAM, done, ok

UNIT = "micromanip-gateway.service"
TOKENS = Path("/var/lib/micromanip-gateway/gateway-tokens")
ADDRESS = "http://127.0.0.1:8090"


class Gateway:
    """The unit, and what its pages say."""

    def show(self, name):
        return ok("systemctl", "show", "--value", "--property", name, UNIT).strip()

    @property
    def pid(self):
        return int(self.show("MainPID"))

    def journal(self):
        return ok("journalctl", "--no-pager", "--output=cat", "--lines=30", f"--unit={UNIT}")

    def get(self, path, scope="observe", body=None):
        lines = [line.split() for line in TOKENS.read_text().splitlines() if not line.startswith("#")]
        secret = next(token for _, its, token in lines if its == scope)
        headers = {"authorization": f"Bearer {secret}", "content-type": "application/json"}
        request = urllib.request.Request(ADDRESS + path, body and json.dumps(body).encode(), headers)
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.read().decode()

    def sees(self, state):
        def is_seen():
            try:
                told = json.loads(self.get("/api/status"))["status"]
            except (OSError, ValueError, StopIteration):
                return False
            return (told and told["state"]) == state

        until(is_seen, lambda: f"it does not see {state}\n{self.journal()}", 60.0)

    def as_itself(self, *command):
        """Run a command in the unit's view of the files, as its user, with its groups; its exit status."""
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        status = {name: value.split() for name, _, value in (line.partition(":") for line in lines)}
        groups = ",".join(status["Groups"])
        who = ["setpriv", f"--reuid={status['Uid'][0]}", f"--regid={status['Gid'][0]}", f"--groups={groups}"]
        return done("nsenter", f"--target={self.pid}", "--mount", *who, *command).returncode


@pytest.fixture
def gateway(service):
    service.start()
    ok("systemctl", "start", UNIT)
    made = Gateway()
    made.sees("READY")
    yield made
    ok("systemctl", "stop", UNIT)


def test_it_starts_as_a_nobody_that_the_controller_knows(gateway, service):
    user = Path(f"/proc/{gateway.pid}").stat().st_uid
    assert user != 0
    assert user != int(ok("id", "-u", "micromanip"))
    status = Path(f"/proc/{gateway.pid}/status").read_text()
    assert "CapEff:\t0000000000000000" in status
    assert "CapBnd:\t0000000000000000" in status
    assert "NoNewPrivs:\t1" in status
    assert stat.S_IMODE(TOKENS.stat().st_mode) == 0o600
    assert "micromanip_up 1.0" in gateway.get("/metrics")
    gateway.get("/api/order", "operate", {"order": "arm"})
    service.reach("TRACKING")
    entry = json.loads(ok(PROGRAM, "log", "--last", "1", "--json"))["entries"][-1]
    assert (entry["verb"], entry["uid"]) == ("arm", user)
    assert entry["user"] == "micromanip-gateway for operator"


def test_it_writes_into_its_own_folder_only(gateway):
    assert gateway.as_itself("touch", "/var/lib/micromanip-gateway/mine") == 0
    for place in ("etc/micromanip", "var/lib/micromanip", "run/micromanip", "opt/micromanip", "usr", "home", "dev"):
        assert gateway.as_itself("touch", f"/{place}/mine") != 0, place
    assert gateway.as_itself("test", "-r", "/etc/micromanip/cell.yaml") == 0
    assert gateway.as_itself("test", "-e", "/dev/cpu_dma_latency") != 0


def test_it_comes_back_after_kill_9_and_the_loop_does_not_notice(gateway, service):
    service.track()
    tokens, killed = TOKENS.read_bytes(), gateway.pid
    cycles = service.status_report()["cycles"]
    ok("kill", "-9", str(killed))
    until(lambda: gateway.pid not in (0, killed), gateway.journal, 60.0)
    gateway.sees("TRACKING")
    assert int(gateway.show("NRestarts")) == 1
    assert TOKENS.read_bytes() == tokens
    assert service.state == "TRACKING"
    assert service.status_report()["cycles"] > cycles
    assert service.show("NRestarts") == "0"


def test_it_outlives_the_controller_and_finds_the_next_one(gateway, service):
    first = gateway.pid
    ok("systemctl", "stop", "micromanip")
    gateway.sees(None)
    service.start()
    gateway.sees("READY")
    assert gateway.pid == first


def test_a_file_of_tokens_that_others_read_ends_it_for_good(gateway):
    TOKENS.chmod(0o644)
    try:
        done("systemctl", "restart", UNIT)
        until(lambda: gateway.show("ActiveState") == "failed", gateway.journal, 60.0)
        assert gateway.show("ExecMainStatus") == "77"
        assert gateway.show("NRestarts") == "0"
        assert "others may read these tokens" in gateway.journal()
    finally:
        TOKENS.chmod(0o600)
        ok("systemctl", "reset-failed", UNIT)
