"""The bench: the whole daemon against an emulated device, in real processes, brought to a state and back."""

import json
import os
import signal
import subprocess
import threading
import time
import uuid
from contextlib import suppress

from micromanip.client import Client
from micromanip.errors import DeviceUnavailable, MicromanipError

from .running_controller import MICROMANIP, PATIENCE_S, SIMULATE, TAG, Running, tagged, until

WATCHDOG_MS = 100.0


class Device:
    """Plays what answers on the buses of a configuration."""

    def __init__(self, config, tag, watchdog_ms):
        self.folder = config.parent
        self._err = (self.folder / "device.err").open("wb")
        self.process = subprocess.Popen(
            [str(MICROMANIP), *SIMULATE, str(config), "--commands", "--watchdog", str(watchdog_ms)],
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
        if self.process.poll() is not None:
            raise DeviceUnavailable(self.said)

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


class Bench:
    """Device and daemon on one configuration; the daemon is READY."""

    def __init__(self, folder, text, watchdog_ms=WATCHDOG_MS):
        """`text` is the configuration, its files named absolutely or in `folder`."""
        folder.mkdir(parents=True, exist_ok=True)
        self.tag, self._folder, self._text = uuid.uuid4().hex, folder, text
        (folder / "cell.yaml").write_text(text)
        self.device = Device(folder / "cell.yaml", self.tag, watchdog_ms)
        self.running = Running(folder, text)
        try:
            self.running.reach("READY")
        except BaseException:
            self.end()
            raise

    def start_again(self):
        """Another daemon in place of the one that was killed, on the device as that one left it."""
        self.running.release()
        self.running = Running(self._folder, self._text)
        self.running.reach("READY")

    @property
    def worker(self):
        """Process number of the (first) worker."""
        return until(lambda: self.running.child_of("micromanip.bus.worker"), self.running.last_words)

    def client(self):
        return Client(self.running.socket)

    def link(self):
        """What the daemon says of the bus."""
        with self.client() as client:
            return next(iter(client.status()["links"].values()))

    def track(self):
        """Reset, arm, wait for TRACKING; tries again while a sensor or a link is not back yet. How long it took (s)."""
        return self._bring_to("TRACKING", FAULT="reset", READY="arm")

    def rest(self):
        """Disarm and come to rest; what a machine that stood still brought about meanwhile is reset."""
        self._bring_to("READY", FAULT="reset", TRACKING="disarm")

    def _bring_to(self, goal, **verbs):
        """Wait for a state; until then each state that has a verb gets it, over and over."""
        begin = time.monotonic()
        refused = ""
        while (state := self.running.state) != goal:
            assert time.monotonic() - begin < PATIENCE_S, f"no {goal}: {refused}; {self.running.last_words()}"
            if state in verbs:
                try:
                    with self.client() as client:
                        getattr(client, verbs[state])()
                except MicromanipError as problem:
                    refused = str(problem)
            time.sleep(0.02)
        return time.monotonic() - begin

    def end(self):
        """Stop both: the daemon's exit code, the device's, and the processes that were left."""
        code = played = None
        with suppress(Exception):
            code = self.running.end() if self.running.process.poll() is None else self.running.process.returncode
        with suppress(Exception):
            played = self.device.end()
        left = [*self.running.kill(), *(pid for pid in tagged(self.tag) if pid != self.device.process.pid)]
        if played is None:
            self.device.process.kill()
        self.running.release()
        return code, played, left
