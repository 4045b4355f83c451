"""One daemon on one bus, one fault after the other; what is left behind at the end."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from .bench import Bench, Outcome
from .cases import Case

CONFIG = Path(__file__).parents[2] / "config"
SHARED = Path("/dev/shm")


def can_cell(channel: str) -> str:
    """config/can.yaml on a channel of its own, ready and not armed."""
    text = (CONFIG / "can.yaml").read_text(encoding="utf-8")
    assert "channel: can0\n" in text
    text = text.replace("channel: can0\n", f"channel: {channel}\n").replace(" can/", f" {CONFIG}/can/")
    text = text.replace("arm_on_start: true ", "arm_on_start: false")
    # off among the limits of a simulation: a stall of the machine would be taken for it too
    text, watched = re.subn(r"(?m)^(    strain: \{coast_ms.*)$", r"\1\n    disagreement: {ratio: 3.0e+4}", text)
    assert watched == 1
    return text


def campaign(folder: Path, cases: tuple[Case, ...], channel: str) -> Iterator[Outcome]:
    """The outcome of each case, then one of the end: processes, descriptors and shared memory that were left."""
    shared = set(SHARED.iterdir())
    bench = Bench(folder, can_cell(channel))
    code, left = None, []
    try:
        bench.track()
        before = bench.running.descriptors
        for case in cases:
            yield bench.try_out(case)
        grown = bench.running.descriptors - before
    finally:
        code, played, left = bench.end()
    end = Outcome("the end")
    if (code, played) != (0, 0):
        end.wrong.append(f"daemon and device ended with {code} and {played}")
    if left:
        end.wrong.append(f"processes left: {left}")
    if grown > 0:
        end.wrong.append(f"the daemon has {grown} descriptors more than before")
    if kept := set(SHARED.iterdir()) - shared:
        end.wrong.append(f"shared memory left: {kept}")
    yield end
