"""The whole daemon against simulated devices, in real processes: what a fault does, and whether it can be undone."""

import math
import time
import uuid
from contextlib import suppress
from dataclasses import asdict, dataclass, field

from micromanip.client import Client
from micromanip.errors import MicromanipError
from micromanip.faults import KINDS
from micromanip.rt import mailbox as w
from micromanip.rt.states import NO_FAULT
from tools.emulated_device import Device
from tools.own_shared_memory import Folder
from tools.running_controller import PATIENCE_S, Running, tagged, until

WATCHDOG_MS = 100.0
_STEP_V = 0.01
"""What a frame resolves of a voltage."""
_STOOD_STILL_MS, _TRIES = 5.0, 3
"""A case that went wrong while loop or device came so late is tried again: what was seen was the machine's doing."""


@dataclass
class Outcome:
    """What followed a fault; `wrong` is what must not have."""

    name: str
    code: str = ""
    detected_ms: float = math.nan
    message: str = ""
    lowest_V: float = math.nan
    highest_V: float = math.nan
    back_s: float = math.nan
    """From the end of the fault to tracking again."""
    late_ms: float = math.nan
    """How late the loop or an event of the device came, at most."""
    before: list = field(default_factory=list)
    """How late that was in the tries before, which went wrong."""
    grown: dict = field(default_factory=dict)
    """Counters of the bus that grew, and by how much."""
    wrong: list = field(default_factory=list)
    note: str = ""

    def as_dict(self):
        return asdict(self)


class Bench:
    """Device and daemon on one configuration, tracking."""

    def __init__(self, folder, text, watchdog_ms=WATCHDOG_MS, module_of_worker="micromanip.bus.worker", prefix=()):
        """`text` is the configuration, its files named absolutely or in `folder`; a `prefix` goes before commands."""
        folder.mkdir(parents=True, exist_ok=True)
        self.tag, self._folder, self._text = uuid.uuid4().hex, folder, text
        (folder / "cell.yaml").write_text(text)
        self.device = Device(folder / "cell.yaml", self.tag, watchdog_ms, prefix)
        self.running = Running(folder, text, prefix=prefix)
        self._module = module_of_worker
        try:
            self.running.reach("READY")
        except BaseException:
            self.end()
            raise

    def shared_memory(self):
        """The folders of both for it, which a `prefix` has given them."""
        return [Folder(each.process.pid) for each in (self.device, self.running)]

    def start_again(self):
        """Another daemon in place of the one that was killed, on the device as that one left it."""
        self.running.release()
        self.running = Running(self._folder, self._text)
        self.running.reach("READY")

    @property
    def worker(self):
        """Process number of the (first) worker."""
        return until(lambda: self.running.child_of(self._module), self.running.last_words)

    @property
    def _state(self):
        return self.running.status["state"][0]

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

    def try_out(self, case):
        """Bring a fault about, see what follows, undo it; the outcome."""
        late_ms = []
        while (outcome := self._tried(case)).wrong and outcome.late_ms >= _STOOD_STILL_MS and len(late_ms) < _TRIES - 1:
            late_ms.append(outcome.late_ms)
        outcome.before = late_ms
        return outcome

    def _tried(self, case):
        outcome = Outcome(case.name)
        self.device.report()
        counts = self.link()["counts"]
        said = len(self.running.said)
        begin_ns = time.monotonic_ns()
        case.act(self)
        self._watch(case, outcome, begin_ns)
        self.device.order(device="clear")
        report = self.device.report()
        outcome.late_ms = max(report["stalls"]["latest_ms"], self._loop_late_ms(begin_ns))
        arrived = report["outputs"]
        outcome.lowest_V = min((each["min"] for each in arrived.values() if each["samples"]), default=math.nan)
        outcome.highest_V = max((each["max"] for each in arrived.values() if each["samples"]), default=math.nan)
        self._judge(case, outcome, counts, said)
        outcome.back_s = self.track()
        return outcome

    def _watch(self, case, outcome, begin_ns):
        """Wait for the fault, or for the time in which none may come."""
        end = time.monotonic() + (PATIENCE_S if case.codes else case.lasts_s)
        while time.monotonic() < end and self._state["fault"] == NO_FAULT:
            time.sleep(0.002)
        state = self._state
        if state["fault"] != NO_FAULT:
            fault = int(state["fault"])
            outcome.code = KINDS[fault].code
            outcome.detected_ms = (self._time_of(int(state["fault_cycle"])) - begin_ns) * 1e-6
            until(lambda: self.running.state == "FAULT", lambda: f"no FAULT; {self.running.last_words()}")
            with self.client() as client:
                outcome.message = (client.status()["faults"] or [""])[0]
            time.sleep(max(0.0, case.lasts_s - (time.monotonic_ns() - begin_ns) * 1e-9))

    def _time_of(self, cycle):
        """When a cycle was due (CLOCK_MONOTONIC, ns)."""
        ring = self.running.ring
        row = ring["rows"][(int(ring["words"][w.RING_HEAD]) - 1) % len(ring["rows"])]
        period_ns = int(self.running.control["parameters"][0]["period_ns"])
        return int(row["time_ns"]) - (int(row["cycle"]) - cycle) * period_ns

    def _loop_late_ms(self, begin_ns):
        """How late the loop came at most since `begin_ns`."""
        rows = self.running.ring["rows"]
        return float(rows["lateness_ns"][rows["time_ns"] >= begin_ns].max(initial=0)) * 1e-6

    def _judge(self, case, outcome, counts, said):
        wrong = outcome.wrong
        if not case.codes and outcome.code:
            wrong.append(f"{outcome.code} instead of tracking on")
        if case.codes and outcome.code not in case.codes:
            wrong.append(f"{outcome.code or 'nothing'} instead of {' or '.join(case.codes)}")
        if case.codes and not outcome.detected_ms <= case.within_ms:
            wrong.append(f"noticed after {outcome.detected_ms:.0f} ms, not within {case.within_ms:g} ms")
        limits = self.running.control["parameters"][0]["axis"]["limiter"]
        if outcome.lowest_V < limits["low_V"].min() - _STEP_V or outcome.highest_V > limits["high_V"].max() + _STEP_V:
            wrong.append(f"an output left its range: {outcome.lowest_V:.2f} to {outcome.highest_V:.2f} V")
        if self.running.process.poll() is not None:
            wrong.append("the daemon ended")
        text = self.running.said[said:]
        if case.said not in text:
            wrong.append(f"people were not told of {case.said!r}: {text!r}")
        time.sleep(0.6)  # counters come twice a second
        outcome.grown = {name: now - counts.get(name, 0) for name, now in self.link()["counts"].items()}
        wrong += [f"{name} did not grow" for name in case.counted if not outcome.grown.get(name, 0) > 0]

    def end(self):
        """Stop both; what they left alive."""
        code = None
        with suppress(Exception):
            code = self.running.end() if self.running.process.poll() is None else self.running.process.returncode
        played = None
        with suppress(Exception):
            played = self.device.end()
        left = [*self.running.kill(), *(pid for pid in tagged(self.tag) if pid != self.device.process.pid)]
        if played is None:
            self.device.process.kill()
        self.running.release()
        return code, played, left
