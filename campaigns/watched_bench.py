"""The watched bench: one device, an oracle at its outputs, and controllers that come and go."""

import json
import os
import signal
import subprocess
import threading
import time
import uuid
from contextlib import suppress

from micromanip.client import Client
from micromanip.errors import MicromanipError

from .oracle import SHOWN, Arrivals, Interleaving, Oracle, Violation, few
from .played.amplifier import Amplifier
from .running_controller import MICROMANIP, PARK, TAG, Running, command_line, tagged
from .steps import act, plan

_LOOK_S = 0.05
_GONE_S, _START_S, _BACK_S = 40.0, 400.0, 25.0
_REST_S = 10.0
_AGAIN_S = 0.02
_ASTRAY_CYCLES = 60
"""So many cycles in a row a loop may not track without its outputs."""
_WITH_THE_LOOP = ("at rest", "following")
"""Outputs that are where the loop has them."""
_AT_REST = ("STARTING", "READY", "FAULT", "OFF")
_SAID_SAFE = "at their safe value"
MODULES = {"loop": "host.loop_process", "black box": "host.trips.process", "worker": "bus.worker_process"}


class WatchedBench:
    """Device, oracle, and the controller of the moment."""

    def __init__(self, folder, cell, habits, watchdog, settle_ms):
        """What the device does by itself, and what its configuration says of that."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.cell = folder, cell
        self.tag = uuid.uuid4().hex
        self.arrivals = Arrivals()
        self.amplifier = Amplifier(habits, self.arrivals)
        self.port = cell.port(self.amplifier, folder)
        self.text = cell.text(self.port.place, watchdog, settle_ms)
        self.config = folder / "cell.yaml"
        self.config.write_text(self.text)
        self._in_force = self.text, {}
        """A file, and what was set since."""
        self.oracle = Oracle(self.arrivals, cell.bounds(*self._in_force))
        self.running, self._said_last = None, ""
        self.found = []
        """Violations beside those of the oracle, since the last interleaving."""
        self.notes = []
        """What happened: (CLOCK_MONOTONIC in ns, text)."""
        self._timers, self._jobs = [], []
        self._ending = threading.Event()
        self._observer = threading.Thread(target=self._observe, daemon=True)
        self._observer.start()

    def interleave(self, seed, number):
        """Do the steps of number `number`, bring everything back, judge."""
        self.found, self.notes = [], []
        done = Interleaving(number, plan(seed, number))
        begin_ns, before = time.monotonic_ns(), self.arrivals.count
        if self.oracle.at_rest():
            self.oracle.settled()
        for step in done.steps:
            act(self, step)
            time.sleep(step.pause_ms * 1e-3)
        self.note("back to READY")
        self.bring_back()
        end_ns = time.monotonic_ns()
        done.largest_step_V = self.oracle.largest_step_V()
        done.violations = few([*self.oracle.judge(begin_ns, end_ns), *self.found])
        done.seconds, done.arrivals = (end_ns - begin_ns) * 1e-9, self.arrivals.count - before
        done.course = [[round((at_ns - begin_ns) * 1e-6), text] for at_ns, text in self.notes]
        return done

    # -- the controller ---------------------------------------------------------------------------------------------

    @property
    def alive(self):
        """Whether there is a controller's host."""
        return self.running is not None and self.running.process.poll() is None

    @property
    def socket(self):
        return self.folder / "control.sock"

    def client(self):
        return Client(self.socket)

    def note(self, text):
        self.notes.append((time.monotonic_ns(), text))

    def wrong(self, rule, what):
        """A rule was broken."""
        self.found.append(Violation(rule, what))

    def start(self):
        """Start a controller and wait until it is READY or has ended; nothing where there is one."""
        if self.alive:
            return
        self.let_go()
        text = self.config.read_bytes()
        places = ("--socket", str(self.socket), "--trips", str(self.folder / "trips"))
        self.running = Running(self.folder, None, *places, config=self.config)
        end = time.monotonic() + _START_S
        while self.alive and time.monotonic() < end:
            self.amplifier.latched = False  # by its watchdog, since nobody wrote to it for so long
            with suppress(MicromanipError, TimeoutError), self.client() as client:
                if client.status()["state"] == "READY":
                    self.note("a controller is READY")
                    self.file_in_force(text)
                    return
            time.sleep(0.1)
        self.note(f"the start ended with {self.running.process.poll()}: {self.running.said[-300:]}")

    def start_known(self):
        """The first: a person vouches for a device that nobody knows anything of. Why it does not start, if so."""
        self.note(f"a device with {self.amplifier.habits}")
        return self._ready(time.monotonic() + _BACK_S)

    def file_in_force(self, text):
        """The controller has taken over a file, or may have; one that isn't valid changes nothing that is allowed."""
        self._allow(text.decode(errors="replace"), {})

    def set_in_force(self, changes):
        """It has accepted `set`."""
        text, before = self._in_force
        self._allow(text, before | changes)

    def _allow(self, *given):
        bounds = self.cell.bounds(*given)
        if bounds is not None:
            self._in_force = given
            if bounds != self.oracle.bounds:
                self.oracle.change(bounds, time.monotonic_ns())

    def let_go(self):
        """Of a controller that has ended; says what was wrong with its end."""
        if self.running is None:
            return
        running, self.running = self.running, None
        self._said_last = running.said
        code = running.process.wait()
        end = time.monotonic() + _GONE_S
        while tagged(running.tag) and time.monotonic() < end:
            time.sleep(_AGAIN_S)
        if left := [command_line(pid) for pid in tagged(running.tag)]:
            self.wrong("left", f"processes {_GONE_S:g} s after the host ended with {code}: {left}")
            running.kill()
        said, out = running.said, running.out
        self.note(f"the controller ended with {code}")
        if code not in (0, 1, 69, 78, -signal.SIGKILL):
            self.wrong("crash", f"exit code {code}: {said[-600:]}")
        if "Traceback" in said or "bug:" in said:
            at = max(said.find("Traceback"), said.find("bug:"))
            self.wrong("crash", said[at : at + 1500])
        now_ns = time.monotonic_ns()
        with suppress(ValueError):
            report = json.loads(out)
            if "error" not in report:
                self._believe(report, now_ns, now_ns, "the report at its end")
        running.release()

    def _believe(self, status, from_ns, to_ns, whence):
        """Note what a report says of the outputs."""
        rule = SHOWN if self.cell.blind and self.port.is_cut else "claim"
        if status["state"] in ("READY", "OFF"):
            elsewhere = [link["outputs"] for link in status["links"].values() if link["outputs"] not in _WITH_THE_LOOP]
            links = [(link["link"], link["outputs"]) for link in status["links"].values()]
            who = f"{whence} says state {status['state']}" + (f", outputs {elsewhere[0]}" if elsewhere else f" {links}")
            self.oracle.claim(from_ns, to_ns, who, SHOWN if elsewhere and status["state"] == "OFF" else rule)
        for name, link in status["links"].items():
            if link["outputs"] == "at rest":
                self.oracle.claim(from_ns, to_ns, f"{whence} says outputs of {name} at rest", rule)

    def _observe(self):
        """Ask and listen all the time, in a thread of its own."""
        client, heard, away = None, (None, 0), None
        while not self._ending.wait(_LOOK_S):
            running = self.running
            if running is not None:
                if heard[0] is not running:
                    heard = (running, 0)
                said = running.said
                if _SAID_SAFE in said[heard[1] :]:
                    now_ns = time.monotonic_ns()
                    self.oracle.claim(now_ns, now_ns, f"the controller said {_SAID_SAFE!r}")
                heard = (running, len(said))
            from_ns = time.monotonic_ns()
            try:
                client = client or self.client()
                status = client.status()
            except (MicromanipError, TimeoutError, OSError, ValueError):
                with suppress(Exception):
                    client.close()
                client = away = None
                continue
            self._believe(status, from_ns, time.monotonic_ns(), "status")
            away = self._follow(status, away)
        if client is not None:
            client.close()

    def _follow(self, status, away):
        """A loop that tracks has its outputs; returns the cycle since which it has not, None where it has."""
        outputs = [link["outputs"] for link in status["links"].values()]
        if status["state"] not in ("TRACKING", "HOLDING") or set(outputs) == {"following"}:
            return None
        away = status["cycles"] if away is None else away
        if status["cycles"] - away > _ASTRAY_CYCLES:
            self.wrong("astray", f"{status['state']} for {status['cycles'] - away} cycles, its outputs are {outputs}")
        return away

    # -- what lasts -------------------------------------------------------------------------------------------------

    def later(self, ms, action):
        """Do something after a while, whatever happens meanwhile."""
        timer = threading.Timer(ms * 1e-3, action)
        timer.start()
        self._timers.append(timer)

    def freeze(self, who, ms):
        """Stop a process, or the device, for a while."""
        if who == "device":
            if self.port.frozen.acquire(timeout=1.0):
                self.later(ms, self.port.frozen.release)
            return
        pid = self.process(who)
        if pid is None:
            return
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGSTOP)
        self.later(ms, lambda: _go_on(pid))

    def process(self, who):
        """Its number; None where it doesn't live."""
        if self.running is None:
            return None
        if who == "host":
            return self.running.process.pid if self.alive else None
        return self.running.child_of(f"micromanip.{MODULES[who]}")

    def park(self, wait_s, *more):
        """Start the command; what it says at its end is a claim."""
        job = threading.Thread(target=self._park, args=(wait_s, *more))
        job.start()
        self._jobs.append(job)
        return job

    def _park(self, wait_s, *more):
        done = subprocess.run(
            [str(MICROMANIP), *PARK, str(self.config), "--wait", str(wait_s), *more],
            capture_output=True,
            check=False,
            cwd=self.folder,
            env=os.environ | {TAG: self.tag, "XDG_STATE_HOME": str(self.folder)},
        )
        now_ns = time.monotonic_ns()
        out, err = done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")
        self.note(f"park ended with {done.returncode}: {(out + err).strip()[:300]}")
        if done.returncode == 0:
            self.oracle.claim(now_ns, now_ns, "park ended with 0")
        elif done.returncode not in (1, 69, 78):
            self.wrong("crash", f"park ended with {done.returncode}: {err[-600:]}")
        if "Traceback" in err:
            self.wrong("crash", f"park: {err[-1500:]}")

    def see_it_rest(self, asked):
        """The outputs come to rest soon after that was asked for, if they can be written to."""
        self.wait_for_what_lasts()
        end = time.monotonic() + _REST_S + self.amplifier.habits.boot_ms * 1e-3
        if not self._rests(end) and not self._is_given_up():
            self.wrong("charged", f"{asked}: the device is at {self.arrivals.volts()}; {self._last_words()}")

    def _rests(self, end):
        """Whether the outputs come to rest until then."""
        while not (rests := self.oracle.at_rest()) and time.monotonic() < end:
            time.sleep(_AGAIN_S)
        return rests

    def _is_given_up(self):
        """Whether the device takes nothing, or the product has said that it takes nobody's word for it any more."""
        unheard = self.cell.hears_by_reads and self.amplifier.fails is not None
        return (
            unheard
            or self.amplifier.latched
            or "is written. Say in `watchdog`" in (self.running.said if self.running else "")
        )

    def wait_for_what_lasts(self):
        """Stops and cuts are over, commands have ended."""
        for each in (*self._timers, *self._jobs):
            each.join()
        self._timers, self._jobs = [], []

    # -- back to the beginning --------------------------------------------------------------------------------------

    def bring_back(self):
        """By documented means: the file mended, the link whole, a controller in READY with that file in force."""
        self.wait_for_what_lasts()
        self.port.mend()
        self.amplifier.mend()
        self.config.write_text(self.text)
        end = time.monotonic() + _BACK_S
        refused = self._ready(end)
        if refused is None and not self._rests(end):
            refused = f"READY, but the device is at {self.arrivals.volts()}"
        if refused is not None:
            self.wrong("return", refused)
            self._anew()
        time.sleep(_AGAIN_S)

    def _ready(self, end):
        """Reset, disarm or start until it is READY with its link up and the mended file; else the reason.

        The file is taken over anew: what was set meanwhile is undone.
        """
        verbs = {"FAULT": "reset", "TRACKING": "disarm", "HOLDING": "disarm", "ARMING": "disarm"}
        refused, restarts = "nothing was refused", 0
        while time.monotonic() < end:
            if not self.alive:
                restarts += 1
                if restarts > 3:
                    break
                self.let_go()
                if "--at-rest" in self._said_last:
                    self._vouch()
                self.start()
                end = max(end, time.monotonic() + _BACK_S / 2)
                continue
            try:
                with self.client() as client:
                    status = client.status()
                    links = status["links"].values()
                    if any(link["link"] == "latched" for link in links):
                        self.note("its link is given up, which a restart mends")
                        self.running.end()
                        self._vouch()
                        end = max(end, time.monotonic() + _BACK_S / 2)
                        continue
                    if status["state"] == "READY" and all(link["link"] == "up" for link in links):
                        client.reload()
                        self.file_in_force(self.text.encode())
                        return None
                    if status["state"] in _AT_REST:  # a person resets no device under the hand of a loop
                        self.amplifier.latched = False
                    if status["state"] in verbs:
                        getattr(client, verbs[status["state"]])()
            except (MicromanipError, TimeoutError) as problem:
                refused = str(problem)
            time.sleep(_AGAIN_S)
        return f"it does not come back to READY: {refused}; {self._last_words()}"

    def _vouch(self):
        """A person brings the outputs to rest, and says so."""
        self.let_go()
        self._said_last = ""
        self.amplifier.rest()
        self.park(0, "--at-rest").join()

    def _anew(self):
        """What documented means did not mend: everything is killed, so that the next interleaving begins clean."""
        if self.running is not None:
            self.running.kill()
            with suppress(Exception):
                self.let_go()
        with suppress(FileNotFoundError):
            self.socket.unlink()
        self._vouch()
        self.start()

    def _last_words(self):
        try:
            with self.client() as client:
                status = client.status()
            state = f"state {status['state']}, faults {status['faults']}, links {status['links']}"
        except (TimeoutError, MicromanipError) as problem:
            state = str(problem)
        return f"{state}; {self.running.said[-600:] if self.running else ''}"

    def end(self):
        """Stop everything; what is left behind."""
        try:
            self.wait_for_what_lasts()
            if self.alive:
                self.running.end()
            self.let_go()
        finally:
            self._ending.set()
            self._observer.join()
            self.port.close()
        return [command_line(pid) for pid in tagged(self.tag)]


def _go_on(pid):
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)
