"""The driver's process dies, or stands still: the device gets no half values by it, and no burst of old ones."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import IO, cast

from .hooks import Hooks, settle
from .peer import Peer

_STOPPED_S, _AFTER_S = 0.5, 0.3


class DeathChecks(Hooks):
    """The driver in a process of its own, which is killed and stopped."""

    def test_killed_in_mid_write(self) -> None:
        old, new = self.patterns()
        draw = random.Random(9)
        with self.device() as peer:
            for _ in range(self.kills):
                with self.child(peer, (old, new), "in turns") as process:
                    settle(peer.writes, 2.0)
                    time.sleep(draw.uniform(0.005, 0.02))
                    process.kill()
                    process.wait()
                time.sleep(0.05)
                for write in peer.writes():
                    for name, value in write.items():
                        assert self.equal(value, old[name]) or self.equal(value, new[name]), (
                            f"{name} got {value} of a process that was killed; only {old[name]} and {new[name]} "
                            "were written: half a value"
                        )

    def test_stopped_and_continued(self) -> None:
        old, new = self.patterns()
        with self.device() as peer:
            with self.child(peer, (old, new), "switched") as process:
                assert settle(peer.writes, 2.0), "nothing arrived of what another process wrote"
                process.send_signal(signal.SIGSTOP)
                time.sleep(_STOPPED_S)
                peer.writes()
                process.send_signal(signal.SIGUSR1)  # it takes note of it when it goes on: the new value from then on
                begin = time.monotonic()
                process.send_signal(signal.SIGCONT)
                time.sleep(_AFTER_S)
                writes, took_s = list(peer.writes()), time.monotonic() - begin
            assert writes, f"nothing more arrived after the process had stood still for {_STOPPED_S} s"
            stale = [write for write in writes if any(self.equal(value, old[name]) for name, value in write.items())]
            assert len(stale) <= self.stale_writes, (
                f"{len(stale)} old writes arrived after the process had stood still; at most {self.stale_writes}"
            )
            rate_hz = sum(task.rate_hz * max(1, len(task.outputs)) for task in self.make(peer).tasks if task.outputs)
            most = rate_hz * took_s + self.stale_writes
            assert len(writes) <= most, (
                f"{len(writes)} writes in {took_s:.2f} s after the process had stood still; at most {most:.0f}: a burst"
            )

    @contextmanager
    def child(
        self, peer: Peer, patterns: tuple[Mapping[str, float], Mapping[str, float]], manner: str
    ) -> Iterator[subprocess.Popen[str]]:
        """A process that writes the two patterns, as `child.py` has the manners."""
        options = self.driver.Options.model_validate(dict(peer.options))
        order = {
            "module": self.driver.__module__,
            "name": self.driver.__qualname__,
            "options": options.model_dump(mode="json"),
            "folder": str(self.folder),
            "patterns": [self.ordered(values) for values in patterns],
            "manner": manner,
        }
        command = [sys.executable, "-m", "micromanip.conformance.child"]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment) as process:
            try:
                print(json.dumps(order), file=cast(IO[str], process.stdin), flush=True)
                said = cast(IO[str], process.stdout).readline().strip()
                assert said == "writing", f"the driver could not write in another process: {said or 'it died'}"
                yield process
            finally:
                process.kill()
