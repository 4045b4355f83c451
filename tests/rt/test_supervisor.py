"""Which reason leads to which gains: as the manual's table says, and one cycle after another."""

import re
from pathlib import Path

import pytest

from micromanip.rt import supervisor

from .bench_cell import X, Y, tracking

PAGE = (Path(__file__).parents[2] / "docs" / "architecture.md").read_text(encoding="utf-8")
ROWS = re.findall(r"(?m)^\| `([A-Z_]+)` \|[^|]*\|([^|]*)\|([^|]*)\|([^|]*)\|$", PAGE)


def test_the_table_of_reasons_is_the_supervisors_own():
    written = {name: tuple(cell.strip() for cell in cells) for name, *cells in ROWS}
    names = ("DEMAND_AHEAD", "MISSING", "SWINGING", "GAUGE_LOST", "STAGE_LOST", "DEVICE_BEHIND")
    found = {}
    for bit, name in ((getattr(supervisor, name), name) for name in names):
        outer = "calm" if supervisor.OUTER_CALM & bit else ""
        inner = "calm" if supervisor.INNER_CALM & bit else "waits" if supervisor.INNER_WAITS & bit else ""
        found[name] = (outer, inner, "no" if supervisor.UNSTEADY & bit else "")
    assert written == found


@pytest.mark.many_cycles
def test_gains_are_calm_while_there_is_a_reason_and_come_back_without_it():
    cell = tracking()
    for i in (X, Y):
        cell.p["axis"][i]["fallback"]["K_V_per_um"] *= 0.5
    cell.step()
    u = cell.s["axis"]["supervisor"]
    assert not u["reasons"][: Y + 1].any()
    assert not u["gain_set"][: Y + 1].any()
    for _ in range(3):
        cell.step(periods=1 + supervisor.AT_ONCE)
    assert (u["reasons"][: Y + 1] & supervisor.MISSING).all()
    assert u["gain_set"][: Y + 1].all()
    assert u["reasons"][X] & supervisor.DEMAND_AHEAD, "the outer loop's too, until they were followed for a while"
    while (u["reasons"][: Y + 1] & supervisor.MISSING).any():
        cell.step()
    cell.step()
    assert u["gain_set"][Y] == 0
    for _ in range(supervisor.FOLLOWED + 1):
        cell.step()
    assert u["gain_set"][X] == 0
    assert u["reasons"][X] == 0
