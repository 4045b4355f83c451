"""What the loop may ask of the kernel as the user who asks now: tried in a process of its own."""

from __future__ import annotations

import getpass
import json
import os
import subprocess
import sys

from micromanip.bus.rights import go_before_ordinary_work, lock_memory

from .finding import Finding, Verdict

_NICE = -10
_TRIED = {
    "SCHED_FIFO": (
        "without it every other process delays the loop",
        "LimitRTPRIO= in the unit (system install writes it), or in /etc/security/limits.d: @micromanip - rtprio 90",
    ),
    "locked memory": (
        "memory that was paged out comes back from the disk, in milliseconds",
        "LimitMEMLOCK=infinity in the unit, or in /etc/security/limits.d: @micromanip - memlock unlimited",
    ),
    "nice value": (
        "the host process' sign of life waits behind other work",
        "LimitNICE=-10 in the unit, or in /etc/security/limits.d: @micromanip - nice -10",
    ),
}


def rights_findings(priority: int, *, hardware: bool) -> list[Finding]:
    """Of a loop at `priority`; with `hardware` limits it does not start without, but for the nice value."""
    command = [sys.executable, "-m", "micromanip.host.readiness.rights", str(priority)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30)
    got: dict[str, bool] = json.loads(done.stdout)
    user, findings = getpass.getuser(), []
    for name, (why, mend) in _TRIED.items():
        refused = Verdict.BAD if hardware and name != "nice value" else Verdict.POOR
        found = f"{'allowed' if got[name] else 'refused'} to {user}"
        findings.append(
            Finding(name, Verdict.GOOD, found, why) if got[name] else Finding(name, refused, found, why, mend)
        )
    return findings


def _tried(priority: int) -> dict[str, bool]:
    """In this order: memory is locked while the process is small, and nothing runs at that priority for long."""
    locked, nice, fifo = lock_memory(), go_before_ordinary_work(_NICE), True
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        fifo = False
    return {"SCHED_FIFO": fifo, "locked memory": locked, "nice value": nice}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_tried(int(sys.argv[1]))))
