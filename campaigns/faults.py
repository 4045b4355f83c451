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
from pathlib import Path

import yaml

from micromanip.faults import KINDS
from micromanip.rt import mailbox as w
from micromanip.rt.states import NO_FAULT

from . import fault_cells as cells
from .bench import WATCHDOG_MS, Bench
from .report import CONFIGURATIONS, Report
from .running_controller import until

BUSES = {
    "gcs": cells.gcs_cell,
    "modbus": cells.modbus_cell,
    "line": cells.line_cell,
    "canbus": cells.can_cell,
    "canopen": cells.canopen_cell,
    "udp": cells.udp_cell,
    "ethercat": cells.ethercat_cell,
    "ring": cells.ring_cell,
}
_STEP_V = 0.01
"""What a frame resolves of a voltage."""
_STOOD_STILL_MS, _TRIES = 5.0, 3
"""A case that went wrong while loop or device came so late is tried again: what was seen was the machine's doing."""
_CLOSING_S, _NOTICED_S = 3.0, 5.0


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
    """What followed a fault; `wrong` is what must not have."""

    name: str
    code: str = ""
    detected_ms: float = math.nan
    lowest_V: float = math.nan
    highest_V: float = math.nan
    back_s: float = math.nan
    """From the end of the fault to tracking again."""
    late_ms: float = math.nan
    """How late the loop or an event of the device came, at most."""
    before: list = field(default_factory=list)
    """How late that was in the tries before, which went wrong."""
    wrong: list = field(default_factory=list)


def run(asked):
    """All cases on each bus, or those whose names `only` finds."""
    report = Report()
    for bus in [asked.bus] if asked.bus else BUSES:
        chosen = [case for case in cases(bus) if re.search(asked.only, case.fault)][: asked.count or None]
        rows = []
        for case, outcome in zip([*chosen, None], campaign(asked.folder / bus, BUSES[bus](), chosen), strict=True):
            report.wrong += [f"{bus}: {outcome.name}: {what}" for what in outcome.wrong]
            asked.tell(f"{bus}: {outcome.name}: {outcome.code or '-'}: {'; '.join(outcome.wrong) or 'ok'}")
            if case is not None:
                rows.append(_row(case, outcome))
        report.tables[bus] = rows
    report.notes.append("A case that goes wrong while the machine stands still is tried again, twice at most.")
    return report


def _row(case, outcome):
    span = "" if math.isnan(outcome.lowest_V) else f"{outcome.lowest_V:.1f} to {outcome.highest_V:.1f}"
    verdict = "; ".join(outcome.wrong) or case.note or "as it must be"
    if outcome.before:
        verdict += f" (before, {' and '.join(f'{late:.0f}' for late in outcome.before)} ms late: not)"
    return {
        "fault": case.fault,
        "must follow": " or ".join(case.codes) or "tracks on",
        "followed": outcome.code or "tracked on",
        "ms": None if math.isnan(outcome.detected_ms) else round(outcome.detected_ms),
        "within": case.within_ms or None,
        "outputs, V": span,
        "tracks again after s": None if math.isnan(outcome.back_s) else round(outcome.back_s, 1),
        "verdict": verdict,
    }


def campaign(folder: Path, text: str, chosen, watchdog_ms: float = WATCHDOG_MS):
    """The outcome of each case on the configuration `text`, then of the end: what was left behind."""
    bench = Bench(folder, text, watchdog_ms)
    end, grown = Outcome("the end"), 0
    try:
        bench.track()
        before = bench.running.descriptors
        for case in chosen:
            yield try_out(bench, case)
        bench.rest()
        grown = _grown(bench, before)
    finally:
        code, played, left = bench.end()
    if (code, played) != (0, 0):
        end.wrong.append(f"daemon and device ended with {code} and {played}")
    if left:
        end.wrong.append(f"processes left: {left}")
    if grown > 0:
        end.wrong.append(f"the daemon has {grown} descriptors more than before")
    yield end


def _grown(bench, before):
    """How many descriptors more than `before` stay open: those of our own last calls are closed a moment later."""
    end = time.monotonic() + _CLOSING_S
    while (grown := bench.running.descriptors - before) > 0 and time.monotonic() < end:
        time.sleep(0.05)
    return grown


def try_out(bench, case):
    """Bring a fault about, see what follows, undo it; the outcome."""
    late_ms = []
    while (outcome := _tried(bench, case)).wrong and outcome.late_ms >= _STOOD_STILL_MS and len(late_ms) < _TRIES - 1:
        late_ms.append(outcome.late_ms)
    outcome.before = late_ms
    return outcome


def _tried(bench, case):
    outcome = Outcome(case.fault)
    bench.device.report()
    counts = bench.link()["counts"]
    said = len(bench.running.said)
    begin_ns = time.monotonic_ns()
    case.act(bench)
    _watch(bench, case, outcome, begin_ns)
    bench.device.order(device="clear")
    report = bench.device.report()
    outcome.late_ms = max(report["stalls"]["longest_ms"], _loop_late_ms(bench, begin_ns))
    arrived = [each for each in report["outputs"].values() if each["samples"]]
    outcome.lowest_V = min((each["min"] for each in arrived), default=math.nan)
    outcome.highest_V = max((each["max"] for each in arrived), default=math.nan)
    _judge(bench, case, outcome, counts, said)
    outcome.back_s = bench.track()
    return outcome


def _watch(bench, case, outcome, begin_ns):
    """Wait for the fault, or for the time in which none may come."""
    end = time.monotonic() + case.lasts_s + (_NOTICED_S if case.codes else 0.0)
    while time.monotonic() < end and bench.running.status["state"][0]["fault"] == NO_FAULT:
        time.sleep(0.002)
    state = bench.running.status["state"][0]
    if state["fault"] != NO_FAULT:
        outcome.code = KINDS[int(state["fault"])].code
        outcome.detected_ms = (_time_of(bench, int(state["fault_cycle"])) - begin_ns) * 1e-6
        until(lambda: bench.running.state == "FAULT", lambda: f"no FAULT; {bench.running.last_words()}")
        time.sleep(max(0.0, case.lasts_s - (time.monotonic_ns() - begin_ns) * 1e-9))


def _time_of(bench, cycle):
    """When a cycle was due (CLOCK_MONOTONIC, ns)."""
    ring = bench.running.ring
    row = ring["rows"][(int(ring["words"][w.RING_HEAD]) - 1) % len(ring["rows"])]
    period_ns = int(bench.running.control["parameters"][0]["period_ns"])
    return int(row["time_ns"]) - (int(row["cycle"]) - cycle) * period_ns


def _loop_late_ms(bench, begin_ns):
    """How late the loop came at most since `begin_ns`."""
    rows = bench.running.ring["rows"]
    return float(rows["lateness_ns"][rows["time_ns"] >= begin_ns].max(initial=0)) * 1e-6


def _judge(bench, case, outcome, counts, said):
    wrong = outcome.wrong
    if not case.codes and outcome.code:
        wrong.append(f"{outcome.code} instead of tracking on")
    if case.codes and outcome.code not in case.codes:
        wrong.append(f"{outcome.code or 'nothing'} instead of {' or '.join(case.codes)}")
    if case.codes and not outcome.detected_ms <= case.within_ms:
        wrong.append(f"noticed after {outcome.detected_ms:.0f} ms, not within {case.within_ms:g} ms")
    limits = bench.running.control["parameters"][0]["axis"]["limiter"]
    if outcome.lowest_V < limits["low_V"].min() - _STEP_V or outcome.highest_V > limits["high_V"].max() + _STEP_V:
        wrong.append(f"an output left its range: {outcome.lowest_V:.2f} to {outcome.highest_V:.2f} V")
    if bench.running.process.poll() is not None:
        wrong.append("the daemon ended")
    if case.said not in bench.running.said[said:]:
        wrong.append(f"nobody was told of {case.said!r}: {bench.running.said[said:]!r}")
    time.sleep(0.6)  # counters come twice a second
    grown = {name: now - counts.get(name, 0) for name, now in bench.link()["counts"].items()}
    wrong += [f"{name} did not grow" for name in case.counted if not grown.get(name, 0) > 0]
