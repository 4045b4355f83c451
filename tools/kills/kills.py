"""``kill -9`` of one process of a controller at one moment, and everything that must be true afterwards."""

import json
import os
import signal
import time
from dataclasses import asdict, dataclass, field

from micromanip_drivers.simulated.records import CONTEXT

from micromanip.errors import MicromanipError
from micromanip.host.trips.store import Box, trips
from micromanip.rt import mailbox as w
from tools.running_controller import tagged, until

from .envelope import Envelope
from .moments import Moment

LETHAL = ("host", "loop")
MODULES = {"loop": "loop_process", "recorder": "recording.recorder", "black box": "trips.process"}
DEATH_CODES = {"host": "X-101", "loop": "X-104"}
_WAY_DOWN = ("HOLDING", "RAMPING", "FAULT", "OFF")
_PATIENCE_S = 40.0


@dataclass
class Kill:
    """What one kill led to."""

    victim: str
    moment: str
    state: str = ""
    phase: str = ""
    course: list[str] = field(default_factory=list)
    """States from the kill on, the one at the kill first."""
    outcome: str = "not as documented"
    step_V: float = 0.0
    """Largest change of an output within one cycle, from the kill before (or the start) on."""
    frozen_s: float | None = None
    """How long the outputs of a dead loop stayed as they were before `safe` began to move them."""
    seconds: float | None = None
    """From the kill until the outputs were at park or safe; where the loop lives on, until people were told."""
    violations: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    spoilt: int = 0
    """Armings before, whose polarity check failed because the machine stalled."""

    def document(self):
        return asdict(self)


class Life:
    """One controller from its start to the death of its host or loop; READY and not armed at its beginning."""

    def __init__(self, cell):
        """`cell` was started with ``--record run.h5 --trips trips``, and without ``arm_on_start``."""
        self.cell = cell
        self._trips, self._known = cell.folder / "trips", set()
        cell.reach("READY")
        self.envelope = Envelope(cell)
        self.driver = cell.memory("contexts", CONTEXT)
        try:
            for module in MODULES.values():
                until(lambda module=module: cell.child(module), cell.last_words)
            until(lambda: cell.status["words"][w.SNAPSHOT_DONE], cell.last_words)  # the recorder's file is open
            cell.go_on(200)
            assert cell.state == "READY", f"it began in {cell.state}: nobody has armed it"
            self._descriptors = cell.descriptors
        except BaseException:
            self.envelope.end()
            raise

    def close(self):
        """Stop watching, end what is alive, let go of the memory; returns what should not have been alive."""
        self.envelope.end()
        alive = self.cell.process.poll() is None
        left = [] if alive else self.cell.left
        if alive:
            self.cell.end()
        self.cell.kill()
        del self.driver
        self.envelope.forget()
        self.cell.release()
        return left

    def kill(self, victim, moment, random):
        """Kill `victim`, one of `LETHAL` or another key of `MODULES`, at `moment`; what came of it."""
        kill = Kill(victim, moment)
        try:
            with Moment(self.cell, moment, random) as reached:
                kill.spoilt = reached.spoilt
                self._known.update(file for file in self._new_boxes() if moment != "trip" or _of_a_check(file))
                at_ns = self._strike(kill)
                if victim in LETHAL:
                    getattr(self, f"_{victim}_died")(kill, at_ns)
                else:
                    self._helper_died(kill, at_ns, reached)
            if victim not in LETHAL:
                reached.undo()
                self._no_descriptor_more()
        except (AssertionError, MicromanipError) as wrong:
            kill.violations.append(shortened(str(wrong)))
        kill.step_V = self.envelope.fresh_step()
        kill.violations += self.envelope.fresh_violations()
        return kill

    def _strike(self, kill):
        pid = self.cell.process.pid if kill.victim == "host" else self.cell.child(MODULES[kill.victim])
        assert pid is not None, f"there is no {kill.victim} to kill; {self.cell.last_words()}"
        self.loop = self.cell.loop
        os.kill(pid, signal.SIGKILL)
        return time.monotonic_ns()

    def _note(self, kill, at_ns):
        kill.state, kill.phase = self.envelope.at(at_ns)
        kill.course = self.envelope.names_since(at_ns)

    def _host_died(self, kill, at_ns):
        """The loop notices, brings the outputs to park within the slew limit, and ends; the trip is on disk."""
        cell = self.cell
        code = cell.wait()
        until(lambda: not tagged(cell.tag), lambda: f"left behind: {cell.left}", _PATIENCE_S)
        self.envelope.end()
        self._note(kill, at_ns)
        assert code == -signal.SIGKILL, f"exit code {code}"
        assert kill.course[-1] == "OFF", f"the loop ended in {kill.course[-1]}"
        down = [name for name in kill.course[1:] if name not in ("ARMING", "TRACKING", "READY")]
        assert down == [name for name in _WAY_DOWN if name in down], f"its way down was {kill.course}"
        assert (self.envelope.voltage_V == self.envelope.park_V).all(), f"ended at {self.envelope.voltage_V} V"
        assert not cell.socket.exists(), "the loop left the host's socket behind"
        kill.seconds = (self.envelope.last_ns - at_ns) * 1e-9
        self._boxes(kill)
        kill.outcome = "parked by the loop"

    def _loop_died(self, kill, at_ns):
        """The host makes the outputs safe, says so, and ends with 1; the trip is on disk."""
        cell = self.cell
        self._watch_discharge(kill, at_ns)
        code = cell.wait()
        until(lambda: not tagged(cell.tag), lambda: f"left behind: {cell.left}", _PATIENCE_S)
        self.envelope.end()
        self._note(kill, at_ns)
        assert code == 1, f"exit code {code}; {cell.last_words()}"
        assert self.driver["safe"] == 1, "nobody called `safe` of the driver"
        assert not self.driver["s"]["latched_V"].any(), f"outputs at {self.driver['s']['latched_V']} V"
        assert cell.said.count("X-104 the loop process was killed by signal 9") == 1, cell.said
        assert "driver cell: outputs at their safe value" in cell.said, cell.said
        assert json.loads(cell.out).keys() == {"error", "exit_code"}, f"a report of half a run: {cell.out:.200}"
        assert "Traceback" not in cell.said, cell.said
        assert not cell.socket.exists(), "the host left its socket behind"
        self._boxes(kill)
        kill.outcome = "safe by the host, X-104"

    def _watch_discharge(self, kill, at_ns):
        """Follow the outputs that the host makes safe: faster than the slew limit between no two looks."""
        slew_V_per_s = self.envelope.slew_V_per_s
        before_V, before_ns = self._latched()
        start_V = before_V
        while not self.driver["safe"] and before_ns < at_ns + _PATIENCE_S * 1e9:
            time.sleep(0.0005)
            now_V, now_ns = self._latched()
            step_V = abs(now_V - before_V)
            if (step_V > slew_V_per_s * max(1e-3, (now_ns - before_ns) * 1e-9)).any():
                kill.violations.append(f"a step from {before_V} V to {now_V} V as the loop's outputs were made safe")
            if kill.frozen_s is None and (now_V != start_V).any():
                kill.frozen_s = (now_ns - at_ns) * 1e-9
            before_V, before_ns = now_V, now_ns
        kill.seconds = (before_ns - at_ns) * 1e-9

    def _latched(self):
        return self.driver["s"]["latched_V"][: self.envelope.axes].copy(), time.monotonic_ns()

    def _helper_died(self, kill, at_ns, moment):
        """The loop goes on as if nothing had been; people are told at once; the black box comes back."""
        cell = self.cell
        told = {"recorder": "the recorder of ", "black box": "the black box process died"}[kill.victim]
        until(lambda: told in cell.said, lambda: f"a word about it; {cell.last_words()}", _PATIENCE_S)
        kill.seconds = (time.monotonic_ns() - at_ns) * 1e-9
        if kill.victim == "black box":
            until(lambda: cell.child("trips.process"), lambda: f"a new one; {cell.last_words()}", _PATIENCE_S)
        cell.go_on(100)
        assert cell.loop == self.loop, "there is another loop process"
        cell.reach(moment.leads_to)
        time.sleep(0.1)  # the watching thread has seen it
        self._note(kill, at_ns)
        if moment.leads_to == "FAULT":
            self._boxes(kill)
        kill.outcome = "the loop went on" + ("; started again" if kill.victim == "black box" else "")

    def _boxes(self, kill):
        """Each trip is on disk: complete, every cycle in it once."""
        wanted = DEATH_CODES.get(kill.victim)
        count = 1 + (kill.moment == "trip" and wanted is not None)  # a death that ends the run is a trip of its own

        def found():
            boxes = [Box.load(file) for file in self._new_boxes()]
            return boxes if len(boxes) >= count and all(box.meta["complete"] for box in boxes) else None

        def what():
            states = {file.name: Box.load(file).meta["complete"] for file in self._new_boxes()}
            return f"{count} complete black boxes, there are {states}; {self.cell.said}"

        boxes = until(found, what, _PATIENCE_S)
        self._known.update(self._new_boxes())
        for box in boxes:
            steps = box.rows["cycle"][1:] - box.rows["cycle"][:-1]
            assert (steps == box.rows["periods"][1:]).all(), f"cycles are missing in the box of {box.trip['code']}"
        codes = [box.trip["code"] for box in boxes]
        assert len(codes) == count, f"black boxes of {codes}"
        if wanted is not None:
            assert wanted in codes, f"black boxes of {codes}, {wanted} is missing"

    def _new_boxes(self):
        return [file for file in trips(self._trips) if file not in self._known]

    def _no_descriptor_more(self):
        until(
            lambda: self.cell.descriptors <= self._descriptors,
            lambda: f"{self.cell.descriptors} descriptors of the host, before {self._descriptors}",
            _PATIENCE_S,
        )


def _of_a_check(file):
    return "_X-401_" in file.name or "_X-402_" in file.name


def shortened(text):
    """Without the middle of what a controller says all day long."""
    return text if len(text) < 1000 else f"{text[:300]} ... {text[-700:]}"
