"""READY waits until the loop is on the clock that it follows."""

import asyncio

import pytest

from micromanip.errors import DeviceUnavailable
from micromanip.host import wires
from micromanip.host.wires import on_the_clock


def link(outputs):
    return {"outputs": outputs, "counts": {"locked": 0, "clock_drift_ppb": 900_000, "unlocked": 3}}


def waited(found, ends=lambda: False):
    return asyncio.run(on_the_clock("cell", lambda: link(next(found)), ends))


def test_it_waits_until_the_outputs_follow():
    left = iter(["at rest", "at rest", "following", "at rest"])
    assert waited(left) is True
    assert list(left) == ["at rest"]


def test_it_ends_with_the_controller():
    assert waited(iter([]), ends=lambda: True) is False


def test_a_clock_that_can_not_be_followed_is_told_with_what_is_known(monkeypatch):
    monkeypatch.setattr(wires, "_LOCKS_IN_S", 0.0)
    with pytest.raises(
        DeviceUnavailable, match=r"driver cell: .* lock to its clock: clock_drift_ppb 900000, unlocked 3"
    ):
        waited(iter(["at rest", "at rest", "at rest"]))
