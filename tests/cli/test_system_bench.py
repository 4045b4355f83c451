"""``system bench``: what fails costs nobody the other figures, and what is measured is what the driver does."""

import pytest

from benchmarks import cycle, ethercat_exchange, offline
from benchmarks.runner import Plan, Result, Skipped
from micromanip.cli.system import source_tree
from micromanip.errors import CheckFailed

from .command import code_of

ARGUMENTS = ("system", "bench", "--only", "cycle", "--only", "offline")


def wrong(plan):
    raise CheckFailed("they read 1 and 2")


@pytest.fixture
def one_fails(monkeypatch):
    monkeypatch.setattr(cycle, "run", wrong)
    monkeypatch.setattr(offline, "run", lambda plan: [Result.of("offline", 30.0, "s/s", "real time", 1.0)])


def test_the_figures_of_the_others_are_told(one_fails, capsys):
    assert code_of(*ARGUMENTS) == 1
    said = capsys.readouterr()
    assert "30 s/s" in said.out
    assert "they read 1 and 2" in said.out
    assert said.err.splitlines()[-1] == "micromanip: failed, as said above: cycle"


@pytest.mark.live
@pytest.mark.compiled_only
@pytest.mark.xdist_group("ethercat")
def test_both_exchanges_take_frames_of_the_terminals_on_a_veth(monkeypatch):
    """It asks for that itself: of every second frame at least both must have made the same."""
    monkeypatch.setattr(ethercat_exchange, "_CYCLES", 200)
    try:
        (found,) = ethercat_exchange.run(Plan(source_tree() / "config" / "paper.yaml", 1, 1.0, lambda _: None))
    except Skipped as reason:
        pytest.skip(str(reason))
    assert found.value > 0
    assert found.reference_value > 0
