"""The page of faults in docs/ says what the messages say."""

from pathlib import Path

from micromanip.host.faults_page import render
from micromanip.host.messages import ALL, FAULTS, fault_message
from micromanip.rt import states

DOCUMENT = Path(__file__).parents[2] / "docs" / "faults.md"


def test_page_is_up_to_date():
    assert DOCUMENT.read_text() == render(), "run: python -m micromanip.host.faults_page > docs/faults.md"


def test_every_fault_is_told_completely():
    codes = [text.code for text in ALL]
    assert len(set(codes)) == len(codes)
    page = render()
    for text in ALL:
        assert f"## {text.code}: " in page
        assert all(f"- {cause}\n" in page for cause in text.likely_causes)
        assert text.likely_causes
        assert text.detection.endswith(".")
        assert text.next_step.endswith(".")


def test_message_says_code_what_causes_and_next_step():
    message = fault_message(states.STRAIN_INVALID, "y", 4.0, 3.0)
    text = FAULTS[states.STRAIN_INVALID]
    assert message.startswith("X-201 axis y: no usable strain-gauge sample for 4 cycles (limit 3). Likely: ")
    assert message.endswith(text.next_step)
    assert all(cause in message for cause in text.likely_causes)
