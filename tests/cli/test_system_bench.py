"""``system bench``: what fails costs nobody the other figures."""

from unittest.mock import Mock

from benchmarks import cycle, offline
from benchmarks.runner import Result
from micromanip.errors import CheckFailed

from .command import code_of


def test_the_figures_of_the_others_are_told(monkeypatch, capsys):
    monkeypatch.setattr(cycle, "run", Mock(side_effect=CheckFailed("they read 1 and 2")))
    monkeypatch.setattr(offline, "run", lambda tell: [Result.of("offline", 30.0, "s/s", "real time", 1.0)])
    assert code_of("system", "bench", "--only", "cycle", "--only", "offline") == 1
    said = capsys.readouterr()
    assert "30 s/s" in said.out
    assert "they read 1 and 2" in said.out
    assert said.err.splitlines()[-1] == "micromanip: failed, as said above: cycle"
