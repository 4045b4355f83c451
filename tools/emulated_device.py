"""`micromanip device simulate` in a process of its own, told by lines what to do."""

import json
import os
import signal
import subprocess
import threading

from .running_controller import MICROMANIP, TAG, until


class Device:
    """Plays what answers on the buses of a configuration."""

    def __init__(self, config, tag, watchdog_ms, prefix=()):
        self.folder = config.parent
        self._err = (self.folder / "device.err").open("wb")
        self.process = subprocess.Popen(
            [*prefix, str(MICROMANIP), "device", "simulate", str(config), "--commands", "--watchdog", str(watchdog_ms)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._err,
            start_new_session=True,
            text=True,
            bufsize=1,
            env=os.environ | {TAG: tag},
        )
        self._answers = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        until(lambda: "READY" in self.said or self.process.poll() is not None, lambda: self.said)
        assert self.process.poll() is None, self.said

    @property
    def said(self):
        return (self.folder / "device.err").read_text()

    def _read(self):
        for line in self.process.stdout:
            self._answers.append(json.loads(line))

    def order(self, **command):
        """Give a command; its answer."""
        had = len(self._answers)
        self.process.stdin.write(json.dumps(command) + "\n")
        until(lambda: len(self._answers) > had, lambda: f"no answer to {command}: {self.said}")
        answer = self._answers[-1]
        assert "error" not in answer, answer
        return answer

    def report(self):
        """Figures since the last report."""
        return self.order(report=True)

    def end(self):
        """Ctrl-C; its exit code."""
        self.process.send_signal(signal.SIGINT)
        code = self.process.wait(30)
        self._reader.join(5)
        for stream in (self.process.stdin, self.process.stdout, self._err):
            stream.close()
        return code
