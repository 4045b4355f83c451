"""The page of faults in docs/ says what the messages say."""

from pathlib import Path

import numpy as np

from micromanip.faults import BY_NAME, KINDS, FaultReport, latched
from micromanip.rt import states
from micromanip.rt.records import CELL_STATE
from micromanip.settings.documents.faults_page import render

DOCUMENT = Path(__file__).parents[2] / "docs" / "faults.md"


def test_page_is_up_to_date():
    assert DOCUMENT.read_text() == render(), "run: make docs"


def test_every_fault_is_told_completely():
    assert set(KINDS) == set(range(states.NO_FAULT + 1, states.EVENT_CODES))
    codes = [kind.code for kind in BY_NAME.values()]
    assert len(set(codes)) == len(codes)
    page = render()
    for kind in BY_NAME.values():
        assert f"## {kind.code}: " in page
        assert "; ".join(kind.likely_causes) in page
        assert kind.likely_causes
        assert kind.detection.endswith(".")
        assert kind.next_step.endswith(".")


def test_message_says_code_what_causes_and_next_step():
    text = KINDS[states.STRAIN_INVALID]
    message = str(FaultReport(text, "y", 4.0, 3.0))
    assert message.startswith("X-201 axis y: no usable strain-gauge sample for 4 cycles (limit 3). Likely: ")
    assert message.endswith(text.next_step)
    assert all(cause in message for cause in text.likely_causes)


def state_with(fault, axis, value, limit, cycle=4711):
    state = np.zeros(1, CELL_STATE)[0]
    state["fault"], state["fault_axis"], state["fault_cycle"] = fault, axis, cycle
    state["fault_value"], state["fault_limit"] = value, limit
    return state


def test_of_a_lost_link_the_value_is_its_driver():
    (report,) = latched(state_with(states.LINK_LOST, -1, 1.0, 0.0), ["x"], ["cell", "bus"])
    assert report.seen == "X-108 driver bus: the link is lost"
    (unknown,) = latched(state_with(states.LINK_LOST, -1, np.nan, 0.0), ["x"], ["cell", "bus"])
    assert (unknown.driver, unknown.document()["value"]) == (None, None)
