"""READY waits until every device on a wire of the loop's answers, and the loop is on the clock that it follows."""

import asyncio

import pytest

from micromanip.errors import DeviceUnavailable
from micromanip.host import workers
from micromanip.host.statistics import _seen_from
from micromanip.host.workers import follow


def link(outputs, up="up", **counts):
    return {"outputs": outputs, "link": up, "counts": counts or {"locked": 0, "clock_drift_ppb": 900_000}}


def waited(found, steering=None, ends=lambda: False):
    return asyncio.run(follow(lambda: next(found), steering, ends))


def test_it_waits_until_the_outputs_of_all_follow():
    rests, follows = link("at rest"), link("following")
    left = iter([{"a": rests, "b": follows}, {"a": follows, "b": rests}, {"a": follows, "b": follows}, {}])
    assert waited(left) is True
    assert list(left) == [{}]


def test_a_device_that_does_not_answer_is_told(monkeypatch):
    monkeypatch.setattr(workers, "_ANSWERS_IN_S", 0.0)
    silent, latched = "does not answer: ", "answers, and does not act on what it is sent: received 9, unanswered 9"
    for counts, said in (
        ({"lost": 3}, f"{silent}lost 3"),
        ({"lost": 0}, f"{silent}nothing came at all"),
        ({"received": 9, "unanswered": 9}, latched),
        ({"received": 1, "unanswered": 99}, f"{silent}received 1, unanswered 99"),
    ):
        found = iter([{"cell": link("unknown", "down", **counts)}] * 3)
        with pytest.raises(DeviceUnavailable, match=f"driver cell: its device {said}$"):
            waited(found)


def test_a_clock_that_can_not_be_followed_is_told_with_what_is_known(monkeypatch):
    monkeypatch.setattr(workers, "_LOCKS_IN_S", 0.0)
    with pytest.raises(DeviceUnavailable, match=r"driver cell: .* lock to its clock: clock_drift_ppb 900000$"):
        waited(iter([{"cell": link("at rest")}] * 3), steering="cell")


@pytest.mark.parametrize(
    ("state", "outputs", "told"),
    [("TRACKING", "following", "following"), ("OFF", "following", "unknown"), ("OFF", "at rest", "at rest")],
)
def test_no_link_follows_a_loop_that_has_ended(state, outputs, told):
    assert _seen_from(state, {"link": "up", "outputs": outputs})["outputs"] == told
