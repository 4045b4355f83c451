"""Faults of a bus, one after the other, on one daemon and its emulated device: each noticed in time, each undone.

They stand in ``configurations/faults.yaml``: `do` is what the device is told (for 0.6 s where nothing else is said), or
what befalls the worker; `follows` are faults of the controller, or groups of them, of which one must be latched within
`within_ms`, and without them it tracks on; `counted` are counters of the bus that must grow, `said` what must be told.
"""

import math
import os
import re
import signal
import time
from dataclasses import dataclass, field

import yaml

from micromanip.faults import KINDS
from micromanip.rt import mailbox as w
from micromanip.rt.states import NO_FAULT

from .bench import Bench
from .fault_cells import CELLS
from .report import CONFIGURATIONS, Report
from .running_controller import until

_STEP_V = 0.01
"""What a frame resolves of a voltage."""
_STOOD_STILL_MS, _TRIES = 5.0, 3
"""A case that went wrong while the loop came so late, or a device stood still, is tried again."""
_CLOSING_S, _NOTICED_S, _COUNTED_S = 3.0, 5.0, 0.6


@dataclass(frozen=True)
class Case:
    """One fault."""

    fault: str
    do: list
    codes: tuple = ()
    within_ms: float = 0.0
    counted: tuple = ()
    said: str = ""
    lasts_s: float = 0.6
    note: str = ""

    def act(self, bench):
        """Bring it about on a bench that tracks."""
        for order in self.do:
            if "wait_s" in order:
                time.sleep(order["wait_s"])
            elif "worker" in order:
                _befall(bench.worker, order["worker"])
            else:
                bench.device.order(**{k: v for k, v in ({"for_s": 0.6} | order).items() if v is not None})


def _befall(worker, what):
    """Kill it, or stop it for half a second."""
    os.kill(worker, signal.SIGKILL if what == "kill" else signal.SIGSTOP)
    if what == "stop":
        time.sleep(0.5)
        os.kill(worker, signal.SIGCONT)


def cases(bus):
    """Those of one bus, in their order."""
    known = yaml.safe_load((CONFIGURATIONS / "faults.yaml").read_text(encoding="utf-8"))
    entries = []
    for entry in known["buses"][bus]:
        entries += known["shared"][entry] if isinstance(entry, str) else [entry]
    found = []
    for entry in entries:
        codes = [code for name in entry.get("follows", ()) for code in known["codes"].get(name, (name,))]
        do = entry["do"] if isinstance(entry["do"], list) else [entry["do"]]
        more = {key: value for key, value in entry.items() if key not in ("follows", "do")}
        found.append(Case(do=do, codes=tuple(codes), **more))
    return found


@dataclass
class Outcome:
    """What followed a fault: `wrong` is what must not have; whether loop or device `stood_still` meanwhile."""

    name: str
    wrong: list = field(default_factory=list)
    stood_still: bool = False
    row: dict = field(default_factory=dict)


def run(asked):
    """All cases on each bus, or those whose names `only` finds."""
    report = Report(notes=["A case that goes wrong while the machine stands still is tried again, twice at most."])
    for bus in [asked.bus] if asked.bus else CELLS:
        chosen = [case for case in cases(bus) if re.search(asked.only, case.fault)][: asked.count or None]
        report.tables[bus] = []
        for outcome in played(Bench(asked.folder / bus, CELLS[bus]()), chosen):
            report.wrong += [f"{bus}: {outcome.name}: {what}" for what in outcome.wrong]
            asked.tell(f"{bus}: {outcome.name}: {'; '.join(outcome.wrong) or 'ok'}")
            if outcome.row:
                report.tables[bus].append(outcome.row)
    return report


def played(bench, chosen):
    """The outcome of each case on the bench, then of the end: what was left behind."""
    end, grown = Outcome("the end"), 0
    try:
        bench.track()
        before = bench.running.descriptors
        for case in chosen:
            for _ in range(_TRIES):
                outcome = _tried(bench, case)
                if not (outcome.wrong and outcome.stood_still):
                    break
            yield outcome
        bench.rest()
        closed = time.monotonic() + _CLOSING_S  # those of our own last calls are closed a moment later
        while (grown := bench.running.descriptors - before) > 0 and time.monotonic() < closed:
            time.sleep(0.05)
    finally:
        code, device, left = bench.end()
    if (code, device) != (0, 0):
        end.wrong.append(f"daemon and device ended with {code} and {device}")
    if left:
        end.wrong.append(f"processes left: {left}")
    if grown > 0:
        end.wrong.append(f"the daemon has {grown} descriptors more than before")
    yield end


def _tried(bench, case):
    """Bring a fault about, see what follows, undo it."""
    running, outcome = bench.running, Outcome(case.fault)
    wrong = outcome.wrong
    stalls = bench.device.report()["stalls"]["count"]
    counts, said = bench.link()["counts"], len(running.said)
    begin_ns = time.monotonic_ns()
    case.act(bench)
    code, noticed_ms = _followed(running, case, begin_ns)
    bench.device.order(device="clear")
    report, rows = bench.device.report(), running.ring["rows"]
    late_ms = float(rows["lateness_ns"][rows["time_ns"] >= begin_ns].max(initial=0)) * 1e-6
    outcome.stood_still = late_ms >= _STOOD_STILL_MS or report["stalls"]["count"] > stalls
    expected, arrived = " or ".join(case.codes), [each for each in report["outputs"].values() if each["samples"]]
    low_V, high_V = min((each["min"] for each in arrived), default=0), max((each["max"] for each in arrived), default=0)
    if code not in (case.codes or ("",)):
        wrong.append(f"{code or 'nothing'} instead of {expected or 'tracking on'}")
    if case.codes and not noticed_ms <= case.within_ms:
        wrong.append(f"noticed after {noticed_ms:.0f} ms, not within {case.within_ms:g} ms")
    limits = running.control["parameters"][0]["axis"]["limiter"]
    if low_V < limits["low_V"].min() - _STEP_V or high_V > limits["high_V"].max() + _STEP_V:
        wrong.append(f"an output left its range: {low_V:.2f} to {high_V:.2f} V")
    if running.process.poll() is not None:
        wrong.append("the daemon ended")
    if case.said not in running.said[said:]:
        wrong.append(f"nobody was told of {case.said!r}: {running.said[said:]!r}")
    time.sleep(_COUNTED_S)  # counters come twice a second
    grown = {name: now - counts.get(name, 0) for name, now in bench.link()["counts"].items()}
    wrong += [f"{name} did not grow" for name in case.counted if not grown.get(name, 0) > 0]
    outcome.row = {
        "fault": case.fault,
        "must follow": expected or "tracks on",
        "followed": code or "tracked on",
        "ms": None if math.isnan(noticed_ms) else round(noticed_ms),
        "within": case.within_ms or None,
        "outputs, V": f"{low_V:.1f} to {high_V:.1f}" if arrived else "",
        "tracks again after s": round(bench.track(), 1),
        "verdict": "; ".join(wrong) or case.note or "as it must be",
    }
    return outcome


def _followed(running, case, begin_ns):
    """Code of the fault that came, and after how many ms; waits for it, or for the time in which none may come."""
    end = time.monotonic() + case.lasts_s + (_NOTICED_S if case.codes else 0.0)
    while time.monotonic() < end and running.status["state"][0]["fault"] == NO_FAULT:
        time.sleep(0.002)
    state = running.status["state"][0]
    if state["fault"] == NO_FAULT:
        return "", math.nan
    ring, period_ns = running.ring, int(running.control["parameters"][0]["period_ns"])
    row = ring["rows"][(int(ring["words"][w.RING_HEAD]) - 1) % len(ring["rows"])]
    due_ns = int(row["time_ns"]) - (int(row["cycle"]) - int(state["fault_cycle"])) * period_ns
    code = KINDS[int(state["fault"])].code
    until(lambda: running.state == "FAULT", lambda: f"no FAULT; {running.last_words()}")
    time.sleep(max(0.0, case.lasts_s - (time.monotonic_ns() - begin_ns) * 1e-9))
    return code, (due_ns - begin_ns) * 1e-6
