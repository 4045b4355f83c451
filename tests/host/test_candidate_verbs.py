"""A candidate tuning over the control socket's verbs: offered, compared, promoted, discarded, taken back."""

import re

import pytest

from micromanip.errors import CheckFailed, ConfigError, UsageError
from micromanip.rt import states

from .standin import Cell

K, TI = "axes.x.inner.K_V_per_um", "axes.x.inner.Ti_ms"
BETTER = {K: 0.5, TI: 0.6}


@pytest.fixture
def cell(tmp_path):
    return Cell(tmp_path)


@pytest.fixture
def offered(cell):
    cell("candidate_set", changes=BETTER)
    return cell


@pytest.fixture
def promoted(offered):
    offered("candidate_promote")
    return offered


def refused(cell, message, verb, error=CheckFailed, **fields):
    """It is refused, in these words, and nothing of the candidate or of what runs has changed."""
    before = cell("candidate_show"), cell("get"), len(cell.controller.swaps), len(cell.controller.offers)
    with pytest.raises(error, match=re.compile(f"^{message}$", re.DOTALL)) as told:
        cell(verb, **fields)
    assert before == (cell("candidate_show"), cell("get"), len(cell.controller.swaps), len(cell.controller.offers))
    assert cell.entries[-1][:2] == (verb, False)
    assert cell.entries[-1][3] == str(told.value)


def takes_back(cell, axis=0, value=7.5, limit=3.0):
    """The loop takes back what is on trial, for its error."""
    state = cell.controller.status["state"][0]
    for code in (states.ROLLED_BACK, states.SATURATING):
        event = state["event"][int(state["events"]) % len(state["event"])]
        event["code"], event["axis"], event["value"], event["limit"] = code, axis, value, limit
        state["events"] += 1
    cell.controller.shadow(states.TAKEN_BACK)


def test_none(cell):
    shadow = cell("candidate_show")
    assert (shadow["standing"], shadow["version"], shadow["changed"]) == ("none", None, [])
    assert cell.entries == []
    refused(
        cell,
        "candidate promote refused: there is none; `micromanip candidate set KEY=VALUE` offers a candidate",
        "candidate_promote",
    )
    refused(cell, "candidate discard refused: there is none; nothing to discard", "candidate_discard")


def test_offer(cell):
    """It has a version of its own; what runs is what ran."""
    shadow = cell("candidate_set", changes=BETTER)
    assert (shadow["standing"], shadow["version"]) == ("shadowing", 2)
    assert {c["key"]: (c["old"], c["new"]) for c in shadow["changed"]} == {K: (0.6, 0.5), TI: (0.571, 0.6)}
    assert list(cell.controller.offers[0][0]["axis"]["pid"]["K_V_per_um"]) == [0.5, 0.6, 0.6]
    assert cell.value(K) == 0.6
    assert cell("diff")["differences"] == []
    assert cell.controller.swaps == cell.told == []
    assert cell.entries == [("candidate_set", True, {K: (0.6, 0.5), TI: (0.571, 0.6)}, None)]


WRONG = {
    "value": (ConfigError, {K: -1, TI: 0.6}, f"{K}: expected a number from 1e-09 to 1000000000, not -1"),
    "key": (UsageError, {"axes.x.iner.Ti_ms": 1}, "unknown key axes.x.iner.Ti_ms; did you mean axes.x.inner.Ti_ms.*"),
    "rest": (
        CheckFailed,
        {"axes.x.centre_um": 65.5, K: 0.5, "loop.rate_hz": 5000},
        "nothing was changed, a candidate takes live values only: loop.rate_hz needs restart; "
        "axes.x.centre_um needs disarm",
    ),
}


@pytest.mark.parametrize(("error", "changes", "message"), WRONG.values(), ids=WRONG)
def test_offer_refused(offered, error, changes, message):
    refused(offered, message, "candidate_set", error, changes=changes)


@pytest.mark.parametrize("state", ["READY", "ARMING", "HOLDING", "FAULT"])
def test_only_beside_what_tracks(offered, state):
    offered.controller.state = state
    why = f"refused: the state is {state}; a candidate is compared while TRACKING"
    refused(offered, f"candidate set {why}", "candidate_set", changes={K: 0.4})
    refused(offered, f"candidate promote {why}", "candidate_promote")


def test_promote(promoted):
    """What runs is the candidate, for every verb; only the trial is not over yet."""
    assert promoted("candidate_show")["standing"] == "on trial"
    assert promoted.value(K) == 0.5
    assert {d["key"]: (d["file"], d["running"]) for d in promoted("diff")["differences"]} == {
        K: (0.6, 0.5),
        TI: (0.571, 0.6),
    }
    assert [source.hash for source in promoted.told] == [promoted.controller.prepared.source.hash]
    changes = {"candidate": ("shadowing", "on trial"), K: (0.6, 0.5), TI: (0.571, 0.6)}
    assert promoted.entries[-1] == ("candidate_promote", True, changes, None)
    refused(promoted, "candidate promote refused: the last one is on trial; .*", "candidate_promote")


def test_nothing_else_changes_on_trial(promoted, tmp_path):
    why = r"nothing was changed: the promoted tuning, parameter version 2, is on trial; wait for its end .*"
    refused(promoted, why, "set", changes={K: 0.7})
    refused(promoted, why, "candidate_set", changes={K: 0.7})
    refused(promoted, why, "reload")


def test_confirmed(promoted):
    promoted.controller.shadow(states.CONFIRMED)
    promoted.follow()
    assert promoted.said == ["the promoted tuning, parameter version 2, is confirmed"]
    assert promoted.entries[-1] == ("confirm", True, {"candidate": ("on trial", "confirmed")}, None)
    promoted.follow()
    assert len(promoted.said) == 1
    assert promoted("candidate_show")["standing"] == "confirmed"
    assert [c["key"] for c in promoted("save")["changed"]] == [K, TI]
    promoted("set", changes={"axes.x.inner.Td_ms": 0.1})
    assert (promoted.value(K), promoted("candidate_show")["standing"]) == (0.5, "none")


def test_taken_back_by_the_loop(promoted):
    """What ran before is in force again; people are told once, and the trail knows."""
    trial = promoted.controller.prepared.source.hash
    takes_back(promoted)
    promoted.follow()
    (told,) = promoted.said
    assert told.startswith("W-501 axis x: the promoted tuning was reverted: error 7.50 um rms (limit 3.00 um). ")
    verb, accepted, changes, _ = promoted.entries[-1]
    assert (verb, accepted) == ("take back", True)
    assert changes == {K: (0.5, 0.6), TI: (0.6, 0.571), "candidate": ("on trial", f"taken back: {told}")}
    assert promoted.trail.last(1)["entries"][0]["user"] == "loop"
    shadow = promoted("candidate_show")
    assert (shadow["standing"], shadow["reason"]) == ("taken back", told)
    assert promoted.value(K) == 0.6
    assert promoted("diff")["differences"] == []
    assert [source.hash for source in promoted.told] == [trial, promoted.controller.prepared.source.hash]


@pytest.mark.parametrize("verb", ["get", "set", "diff", "save", "reload", "candidate_show"])
def test_noticed_before_anything_else(promoted, verb):
    """However soon a verb comes after the loop's decision, it finds the former values."""
    takes_back(promoted)
    promoted(verb, **{"set": {"changes": {"axes.x.inner.Td_ms": 0.1}}}.get(verb, {}))
    assert promoted.controller.prepared.configuration.axes["x"].inner.K_V_per_um == 0.6
    assert len(promoted.said) == 1


def test_discard_on_trial(promoted):
    shadow = promoted("candidate_discard")
    assert (shadow["standing"], shadow["reason"]) == ("taken back", "it was discarded")
    assert promoted.value(K) == 0.6
    promoted.follow()
    assert promoted.said == []
    changes = {"candidate": ("on trial", "taken back"), K: (0.5, 0.6), TI: (0.6, 0.571)}
    assert promoted.entries[-1] == ("candidate_discard", True, changes, None)


def test_another_tuning_drops_the_candidate(offered):
    offered("set", changes={"axes.x.inner.Td_ms": 0.1})
    assert offered("candidate_show")["standing"] == "none"
    assert offered.said == ["WARNING: the candidate, parameter version 2, is dropped: another tuning came into force"]
    offered.follow()
    assert offered.entries[-1][0] == "drop"
    refused(offered, "candidate promote refused: .*", "candidate_promote")
