"""The service on a throw-away machine with a real systemd, looked at from outside as an operator would."""

import json
import os
import subprocess
from pathlib import Path

from campaigns.running_controller import command_line, descriptor_of, until
from micromanip.host.shared_memory import RING, STATUS, Segment
from micromanip.rt import mailbox as w
from micromanip.rt.states import STATE_NAMES

PROGRAM = "/opt/micromanip/bin/micromanip"
UNIT = "micromanip.service"
CONFIG = Path("/etc/micromanip/cell.yaml")
MARK = Path("/run/throw-away-machine")


def done(*command, user=None, text=None):
    """Run a command, as `user` if given, else as root even where the scenario itself is nobody; what came of it."""
    as_user = ["runuser", "-u", user, "--"] if user else []
    return subprocess.run(
        [*as_user, *command], capture_output=True, text=True, input=text, cwd="/", check=False, user=0, group=0
    )


def ok(*command, **options):
    """What a command that must succeed prints."""
    outcome = done(*command, **options)
    assert outcome.returncode == 0, f"{' '.join(command)}: {outcome.returncode}\n{outcome.stdout}{outcome.stderr}"
    return outcome.stdout


class Service:
    """micromanip.service, and the memory of its controller."""

    def __init__(self):
        assert MARK.exists(), "this installs and breaks services: only by the campaigns `systemd` and `vm`"
        self._descriptors = []

    def start(self):
        ok("systemctl", "start", UNIT)
        return self.watch()

    def watch(self):
        """Hold the memory of the running host: it outlives the processes."""
        self.release()
        self.host = int(self.show("MainPID"))
        self.ring, self.status = self._memory("ring", RING), self._memory("status", STATUS)
        self.loop = next(pid for pid in self.processes if "micromanip.host.loop_process" in command_line(pid))
        return self

    def _memory(self, name, dtype):
        descriptor = until(lambda: descriptor_of(self.host, f"micromanip-{name}"), f"memory {name}")
        self._descriptors.append(descriptor)
        return Segment.attach(descriptor, writable=False).record(dtype)

    def release(self):
        self.__dict__.pop("ring", None)
        self.__dict__.pop("status", None)
        while self._descriptors:
            os.close(self._descriptors.pop())

    def show(self, name):
        """A property of the unit."""
        return ok("systemctl", "show", "--value", "--property", name, UNIT).strip()

    @property
    def processes(self):
        """Numbers of all processes in the unit's control group."""
        group = Path("/sys/fs/cgroup" + self.show("ControlGroup")) / "cgroup.procs"
        return [int(pid) for pid in group.read_text().split()]

    @property
    def state(self):
        words = self.status["words"]
        return STATE_NAMES[words[w.STATE]] if words[w.CYCLES_RUN] else "STARTING"

    def reach(self, state):
        until(lambda: self.state == state, lambda: f"{state}, it is {self.state}\n{self.journal()}")
        return self

    def track(self):
        ok(PROGRAM, "arm")
        return self.reach("TRACKING")

    def restarted(self, times=1):
        """Wait until systemd has started it again, and it says READY."""
        until(lambda: int(self.show("NRestarts")) == times, lambda: f"restart {times}\n{self.journal()}", 60.0)
        until(lambda: self.show("ActiveState") == "active", lambda: f"active\n{self.journal()}")
        return self.watch()

    def journal(self):
        return ok("journalctl", "--no-pager", "--output=cat", f"--unit={UNIT}", f"--since=@{self.since}")

    def status_report(self):
        return json.loads(ok(PROGRAM, "status", "--json"))

    def drop_in(self, *lines):
        """Settings of this scenario on top of the unit's own; none: the unit's own again."""
        folder = Path(f"/run/systemd/system/{UNIT}.d")
        folder.mkdir(exist_ok=True)
        (folder / "scenario.conf").write_text("\n".join(["[Service]", *lines, ""]))
        ok("systemctl", "daemon-reload")
