"""What ``micromanip learn`` answers: memories, updates and trials, as data and in tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .echo import echo

if TYPE_CHECKING:
    from micromanip.design.learning.law import Update
    from micromanip.design.learning.memory import Learned, Memory
    from micromanip.design.learning.trial import AxisTrial
    from micromanip.status_reply import LearningStatus


def print_running(told: LearningStatus) -> None:
    """The running cell's learning, a row for each axis."""
    from .tables import Figures, out_console

    echo(f"{told['state']}, {told['made']} parts made, memories in {told['folder']}")
    shown = Figures("axis", "memory", "now", "off the path, um", "last part, um", "without, um", "was", "learned, Hz")
    for name, axis in told["axes"].items():
        last = axis["last"] or {}
        memory = "none" if axis["generation"] is None else f"state {axis['generation']}"
        shown.add_row(
            name, memory if axis["may_play"] or axis["generation"] is None else f"{memory}, not played", axis["state"],
            f"{axis['apart_um']:.2f}", *(f"{last[key]:.3f}" if last else "" for key in ("error_um", "without_um")),
            last.get("verdict", ""), _bands(last["learned_Hz"]) if last else "",
        )  # fmt: skip
    out_console().print(shown)


def _learned(now: Learned) -> dict[str, Any]:
    return {
        "parts": now.parts,
        "learned_Hz": [list(band) for band in now.learned_Hz],
        "correction_um": float(abs(now.correction_um).max()),
        "contraction": now.contraction,
    }


def memory_answer(memory: Memory) -> dict[str, Any]:
    """What is said of a memory, in plain JSON types."""
    return {
        "axis": memory.axis, "cell": memory.cell, "tuning": memory.tuning, "path": memory.path,
        "tool": memory.tool, "temperature_C": memory.temperature_C, "seconds": memory.seconds,
        "generation": memory.generation, **_learned(memory.now),
        "story": [dict(each) for each in memory.story],
    }  # fmt: skip


def print_memories(found: Sequence[dict[str, Any]]) -> None:
    """Answers of `memory_answer`, a row for each."""
    from .tables import Figures, out_console

    shown = Figures(
        "axis", "tool", "parts", "state", "learned, Hz", "correction, um", "wrong is left", "last part, um", "was"
    )
    for each in found:
        last = each["story"][-1] if each["story"] else None
        shown.add_row(
            each["axis"], str(each["tool"] or ""), str(each["parts"]), str(each["generation"]),
            _bands(each["learned_Hz"]),
            f"{each['correction_um']:.3f}", f"{100 * each['contraction']:.2g} %",
            "" if last is None else _interval(last["error_um"], (last["error_least_um"], last["error_most_um"])),
            "" if last is None else last["verdict"],
        )  # fmt: skip
    out_console().print(shown)


def update_answer(file: Path, axis: str, found: Update) -> dict[str, Any]:
    """What became of a recording on one axis, in plain JSON types."""
    return {
        "file": str(file), "axis": axis, "verdict": found.verdict, "forgotten": found.forgotten,
        "error_um": found.error_um, "error_95_um": list(found.interval_um),
        "missed_percent": found.memory.story[-1]["missed_percent"], **_learned(found.memory.now),
    }  # fmt: skip


def update_sentence(told: dict[str, Any]) -> str:
    """The same for people."""
    begin = (
        f"{told['file']}: axis {told['axis']}: {_interval(told['error_um'], told['error_95_um'])} um rms in the band "
        f"that is learned, {told['missed_percent']:.2g} % of the cycles missed, {told['verdict']}"
    )
    if told["forgotten"]:
        return f"{begin}: forgotten, back to what was played before"
    if not told["learned_Hz"]:
        return f"{begin}; nothing repeats beyond doubt in {told['parts']} part{'s' * (told['parts'] > 1)}"
    return (
        f"{begin}; learned {_bands(told['learned_Hz'])} Hz from {told['parts']} parts, correction up to "
        f"{told['correction_um']:.3f} um; at most {100 * told['contraction']:.2g} % of what is wrong in it stays"
    )


def _interval(value: float, ends: Sequence[float]) -> str:
    return f"{value:.3f} ({ends[0]:.3f} to {ends[1]:.3f})"


def _bands(bands: Sequence[Sequence[float]]) -> str:
    return ", ".join(f"{low:.3g}-{high:.3g}" for low, high in bands) or "nothing"


def print_trials(found: Sequence[AxisTrial]) -> None:
    """What was tried in virtual time: tables of the path error part by part, and a line for each axis."""
    from .tables import Figures, out_console

    numbers = [f"part {k + 1}" for k in range(len(found[0].parts))]
    whole = Figures("axis", "uncompensated", *numbers, "floor", "over it", title="True path error, um rms")
    repeats = Figures("axis", *numbers, title="What of it repeats, um rms")
    for axis in found:
        last = axis.parts[-1]
        whole.add_row(
            axis.axis, f"{axis.uncompensated_um:.1f}", *(f"{each.whole_um:.3f}" for each in axis.parts),
            f"{last.floor_um:.3f}", f"{last.over_floor:.3f}",
        )  # fmt: skip
        repeats.add_row(axis.axis, *(f"{each.repeats_um:.3f}" for each in axis.parts))
    out_console().print(whole)
    out_console().print(repeats)
    for axis in found:
        verdicts = ", ".join(each.verdict for each in axis.parts)
        echo(f"axis {axis.axis}: learned {_bands(axis.parts[-1].learned_Hz)} Hz; part by part: {verdicts}")
