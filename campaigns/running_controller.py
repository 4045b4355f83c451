"""A controller in real processes, watched from outside: its shared memory, its children, what it leaves behind."""

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from contextlib import suppress
from pathlib import Path

from micromanip.errors import CheckFailed
from micromanip.host.shared_memory import CONTROL, RING, STATUS, Segment
from micromanip.rt import mailbox as w
from micromanip.rt.states import STATE_NAMES

MICROMANIP = Path(sys.executable).with_name("micromanip")
PARK, SIMULATE = ("park",), ("device", "simulate")
"""What is typed to bring outputs to rest, and to play a device."""
TAG = "MICROMANIP_TEST_TAG"
PATIENCE_S = 150.0  # compiling anew, on a busy machine, takes a minute


def as_from_a_terminal():
    """Let Ctrl-C through: what a shell starts in the background, and all that it starts, ignores it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def until(condition, what, patience_s=PATIENCE_S):
    """Wait for `condition()` to be true, and return it; the test fails if that never happens.

    To look takes a fifth of a CPU at most: one that goes through all processes of the machine is no small thing.
    """
    end = time.monotonic() + patience_s
    while True:
        before_s = time.thread_time()
        found = condition()
        if found:
            return found
        assert time.monotonic() < end, f"waited {patience_s:g} s in vain: {what() if callable(what) else what}"
        time.sleep(max(0.01, 4.0 * (time.thread_time() - before_s)))


def reset(client):
    """As soon as the black box of the trip is on disk."""

    def accepted():
        try:
            client.reset()
        except CheckFailed as refused:
            if "try again in a moment" not in str(refused):
                raise
            return False
        return True

    until(accepted, "no reset: the black box is not on disk")


def tagged(tag):
    """Process numbers of all that inherited `tag` and are alive."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                if f"{TAG}={tag}".encode() in (entry / "environ").read_bytes().split(b"\0"):
                    found.append(int(entry.name))
    return found


def command_line(pid):
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return ""


def descriptor_of(pid, memory):
    """A descriptor of our own on the shared memory called `memory` of process `pid`; None before it is there."""
    with suppress(OSError):
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                if str(entry.readlink()).startswith(f"/memfd:{memory} "):
                    return os.open(entry, os.O_RDONLY)
    return None


class Running:
    """``micromanip run`` in a session of its own, as from a terminal of its own."""

    def __init__(self, folder, text, *arguments, prefix=(), config=None):
        """`text` becomes its configuration; with `config`, a file that outlives it, its state is kept beside that."""
        self.tag = uuid.uuid4().hex
        self.folder = folder / self.tag[:6]
        self.folder.mkdir()
        self.config = self.folder / "cell.yaml" if config is None else config
        if config is None:
            self.config.write_text(text)
        self.socket = self.folder / "control.sock"
        self._descriptors = []
        if "--socket" not in arguments:
            arguments = (*arguments, "--socket", str(self.socket))
        with (self.folder / "stdout").open("wb") as out, (self.folder / "stderr").open("wb") as err:
            self.process = subprocess.Popen(
                [*prefix, str(MICROMANIP), "run", str(self.config), "--json", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
                cwd=self.folder,
                preexec_fn=as_from_a_terminal,
                env=os.environ
                | {TAG: self.tag, "TMPDIR": str(self.folder), "COLUMNS": "200"}
                | {"XDG_STATE_HOME": str(self.config.parent)},
            )

    @property
    def out(self):
        return (self.folder / "stdout").read_text()

    @property
    def said(self):
        return (self.folder / "stderr").read_text()

    @property
    def report(self):
        return json.loads(self.out)

    def child(self, module):
        """Process number of the child that runs `module` of the host."""
        return self.child_of(f"micromanip.host.{module}")

    def child_of(self, module):
        """Process number of the child that runs `module`."""
        found = [pid for pid in tagged(self.tag) if module in command_line(pid)]
        return found[0] if found else None

    @property
    def command_line(self):
        return command_line(self.process.pid)

    @property
    def descriptors(self):
        """How many the host has open."""
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))

    def stall(self, seconds):
        """Keep the loop from running for so long."""
        loop = self.loop
        os.kill(loop, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            os.kill(loop, signal.SIGCONT)

    @property
    def loop(self):
        return until(lambda: self.child("loop_process"), self.last_words)

    def last_words(self):
        return f"exit {self.process.poll()}, standard error:\n{self.said}"

    def memory(self, name, dtype, pid=None):
        """The shared memory `name` of the host as a record that outlives its processes."""

        def found():
            assert self.process.poll() is None, self.last_words()
            return descriptor_of(pid or self.process.pid, f"micromanip-{name}")

        descriptor = until(found, self.last_words)
        self._descriptors.append(descriptor)
        until(lambda: os.fstat(descriptor).st_size >= dtype.itemsize, f"size of {name}")
        return Segment.attach(descriptor, writable=False).record(dtype)

    def watch(self):
        """Hold the host's memory from now on."""
        self.ring = self.memory("ring", RING)
        self.status = self.memory("status", STATUS)
        self.control = self.memory("control", CONTROL)
        return self

    @property
    def state(self):
        words = self.status["words"]
        return STATE_NAMES[words[w.STATE]] if words[w.CYCLES_RUN] else "STARTING"

    @property
    def cycles(self):
        return int(self.status["words"][w.CYCLES_RUN])

    def reach(self, state):
        """Wait for `state`; fails at once where the controller ends before."""
        if not hasattr(self, "status"):
            self.watch()

        def reached():
            if self.state == state and (state != "READY" or "READY" in self.said):  # it says STARTING before
                return True
            assert self.process.poll() is None, self.last_words()
            return False

        until(reached, lambda: f"{state}, it is {self.state}; {self.last_words()}")
        return self

    def go_on(self, cycles):
        """Wait until the loop has run so many more cycles."""
        goal = self.cycles + cycles
        until(lambda: self.cycles >= goal, lambda: f"{goal} cycles, there are {self.cycles}; {self.last_words()}")

    def end(self, number=signal.SIGTERM):
        """Ask it to end; the exit code."""
        self.process.send_signal(number)
        return self.wait()

    def wait(self):
        """Wait for the host to end by itself; its exit code."""
        try:
            return self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"it does not end; {self.last_words()}") from None

    @property
    def left(self):
        """What is alive of it."""
        return [command_line(pid) for pid in tagged(self.tag)]

    def gone(self):
        """Wait until no process is left."""
        until(lambda: not tagged(self.tag), lambda: f"left behind: {self.left}")

    def kill(self):
        """Whatever is left of it, for the end of a failed test."""
        left = tagged(self.tag)
        for pid in left:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        return left

    def release(self):
        """Close our own descriptors on its memory."""
        for name in ("ring", "status", "control"):
            self.__dict__.pop(name, None)
        while self._descriptors:
            os.close(self._descriptors.pop())
