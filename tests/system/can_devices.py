"""What answers on vcan0: a foreign device, or the played one of `device simulate`."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from campaigns.running_controller import until

from .machine import CONFIG, PROGRAM, ok
from .vcan import CHANNEL
from .vm_cell import DATABASES

DATABASE = DATABASES / "manipulator.dbc"
PATIENCE_S = 180.0
START_S = 600.0  # importing numba takes an emulated processor a minute, on a busy machine many
OPERATOR = "can-operator"
CACHE = Path("/home") / OPERATOR / ".cache"


class ForeignDevice:
    """``can_peer.py`` in a process of its own."""

    def __init__(self, folder):
        self._log = folder / "commands"
        self._log.touch()
        arguments = (CHANNEL, str(DATABASE), str(self._log))
        self.process = subprocess.Popen([sys.executable, str(Path(__file__).with_name("can_peer.py")), *arguments])

    def commands(self, since_s=0.0):
        """Voltage of each command that it got at or after `since_s` (CLOCK_MONOTONIC)."""
        rows = [line.split() for line in self._log.read_text().splitlines() if line.count(" ") == 2]
        return [float(voltage_V) for came_s, voltage_V, _ in rows if float(came_s) >= since_s]

    def gets(self, number, since_s):
        """Wait for so many commands; their voltages."""
        until(lambda: len(self.commands(since_s)) >= number, "commands", PATIENCE_S)
        return self.commands(since_s)

    @property
    def voltage_V(self):
        return self.commands()[-1]

    def end(self):
        self.process.kill()
        self.process.wait()


class EmulatedDevice:
    """``micromanip device simulate`` for the service's own configuration, as an operator runs it."""

    def __init__(self, folder):
        ok("useradd", "--create-home", "--groups", "micromanip", OPERATOR)
        shutil.copytree("/kept/micromanip", CACHE / "micromanip")
        ok("chown", "-R", f"{OPERATOR}:", str(CACHE))
        self._report, self._said = folder / "report", folder / "said"
        with self._report.open("w") as out, self._said.open("w") as err:
            self.process = subprocess.Popen(
                [PROGRAM, "device", "simulate", str(CONFIG), "--watchdog", "10000", "--json"],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd="/",
                env=os.environ | {"HOME": str(CACHE.parent), "XDG_CACHE_HOME": str(CACHE)},
                user=OPERATOR,
                group=OPERATOR,
                extra_groups=["micromanip"],
            )
        until(
            lambda: "READY" in self._said.read_text() or self.process.poll() is not None, self._said.read_text, START_S
        )
        assert self.process.poll() is None, self._said.read_text()

    def end(self):
        """Ctrl-C; what it reports."""
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(PATIENCE_S) == 0, self._said.read_text()
        return json.loads(self._report.read_text())
