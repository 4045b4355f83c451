"""The simulated cell as a cyclic driver sees it: latch, advance, read; and its safe state."""

from __future__ import annotations

from typing import Any

from micromanip.driver import entries

from .bus import receive_samples, send_outputs, send_samples, write
from .faults import disturb, exchange_error, remember
from .lines import (
    advance_lines,
    cut_share,
    follow_enable,
    latch_switches,
    make_safe,
    powered,
    read_lines,
    worked_periods,
)
from .plant import drive, machining_force, move, push, quantised, read
from .preisach import preisach_step, reset_memory
from .records import CONTEXT, CREEP_OPERATORS, MECHANICAL_STATES, SUBSTEPS, compiled


@compiled
def rest(c: Any) -> None:
    """All axes at rest at 0 V, on the branch that comes up from negative saturation, creep in balance."""
    for i in range(c["axes"]):
        p, s = c["p"][i], c["s"][i]
        reset_memory(s["memory"])
        pure = preisach_step(p["preisach"], s["memory"], 0.0)
        if p["bouc_wen"]["present"] != 0:
            pure = 0.0  # symmetric about 0 V, where it begins
            s["bouc_wen"]["input_V"] = s["bouc_wen"]["internal_um"] = s["bouc_wen"]["lagging_um"] = 0.0
            s["decided_V"][:] = 0.0
        for k in range(CREEP_OPERATORS):
            s["creep_um"][k] = p["creep_gain"] * pure
        for k in range(MECHANICAL_STATES):
            s["x"][k] = p["rest"][k] * pure
        s["rested_um"] = s["x"][2]
        s["latched_V"] = s["amplifier_V"] = 0.0


@compiled
def advance(c: Any) -> None:
    """All axes by one loop period, with the voltages latched."""
    c["periods"] += 1
    advance_lines(c["lines"])
    t_s = worked_periods(c["lines"], c["periods"]) * c["period_ns"] * 1e-9
    on, share = powered(c["lines"]), cut_share(c["lines"])
    for i in range(c["axes"]):
        p, s = c["p"][i], c["s"][i]
        s["force_N"] = share * machining_force(p, s, t_s)
        s["drift_um"] += p["drift_step"] * (p["drift_um"] - s["drift_um"])
        if c["pushes"] == 0:
            for _ in range(SUBSTEPS):
                move(p, s["x"], drive(p, s, on), s["force_N"])
                move(p, s["free_x"], 0.0, s["force_N"])
    if c["pushes"] != 0:
        for _ in range(SUBSTEPS):
            push(c)
            for i in range(c["axes"]):
                p, s = c["p"][i], c["s"][i]
                move(p, s["x"], drive(p, s, on), s["force_N"] + s["pushed_N"])
                move(p, s["free_x"], 0.0, s["force_N"])


@compiled
def latch(c: Any, outputs: Any) -> None:
    """Take the voltages decided in the cycle before: they act from now on, one sample late."""
    for i in range(c["axes"]):
        p, s = c["p"][i], c["s"][i]
        decided = outputs[i]
        for k in range(p["late"]):
            decided, s["decided_V"][k] = s["decided_V"][k], decided
        inside = max(p["low_V"], min(p["high_V"], decided))
        s["latched_V"] = quantised(inside, p["dac_step_V"], 1e9)
    latch_switches(c["lines"], outputs)


@compiled
def exchange(c: Any, outputs: Any, inputs: Any, now_ns: int, periods: int) -> int:
    """One exchange of the loop; advances by the periods that really passed."""
    if c["opened"] == 0:
        return 1
    by_bus = c["bus"]["present"] != 0
    for k in range(periods):
        advance(c)
        if by_bus:
            passing_ns = now_ns - (periods - 1 - k) * c["period_ns"]
            read(c, c["bus"]["reading"], passing_ns)
            read_lines(c, c["bus"]["reading"], passing_ns)
            send_samples(c, passing_ns)
            if k < periods - 1:
                act(c)
    code = exchange_error(c)
    if code == 0:
        remember(c, inputs)
        if by_bus:
            receive_samples(c, inputs)
            write(c, outputs)
        else:
            read(c, inputs, now_ns)
            read_lines(c, inputs, now_ns)
            latch(c, outputs)
        disturb(c, inputs)
        follow_enable(c["lines"], inputs)
    if by_bus:
        act(c)
    return code


@compiled
def act(c: Any) -> None:
    """One period of the outputs' bus: what arrives now is in force from now on."""
    arrived = send_outputs(c)
    if arrived >= 0:
        latch(c, c["bus"]["outputs"][arrived]["value"])


@compiled
def begin(c: Any) -> int:
    """Switch the amplifier on; the stage is at rest."""
    rest(c)
    c["lines"]["enable"] = 1.0
    c["opened"] = 1
    return 0


@compiled
def end(c: Any) -> int:
    """Switch the amplifier off."""
    c["opened"] = 0
    return 0


ENTRIES = entries(compiled, CONTEXT, begin, exchange, make_safe, end)
