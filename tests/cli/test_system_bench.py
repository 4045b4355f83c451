"""``system bench``: what fails costs nobody the other figures, and what is measured is a bus in operation."""

from unittest.mock import Mock

import pytest

from benchmarks import cycle, exchange, offline
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


@pytest.mark.live
@pytest.mark.compiled_only
@pytest.mark.parametrize(("bus", "third"), [("modbus", "modbus_worker"), ("udp", "udp_cycle_p50")])
def test_a_bus_is_measured_in_operation(monkeypatch, bus, third):
    monkeypatch.setattr(exchange, "BUSES", {bus: exchange.BUSES[bus]})
    monkeypatch.setattr(exchange, "_SECONDS", 1.0)
    found = exchange.run(lambda _: None)
    assert [each.name for each in found] == [f"{bus}_rate", f"{bus}_age_p50", third]
    assert all(each.value > 0.0 for each in found)
