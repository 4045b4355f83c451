"""A commissioning that was stopped, in sentences that follow one another whatever the reason ends with."""

import pytest

from micromanip.design.commission.partial import Steps, Stopped
from micromanip.errors import CheckFailed, sentence


@pytest.mark.parametrize("problem", ["nothing was closed", "check its range."])
def test_what_comes_after_the_reason_begins_a_sentence(problem):
    with pytest.raises(Stopped) as stopped, Steps("x", lambda _: None, "major loop").kept():
        raise CheckFailed(problem)
    assert f" {problem.removesuffix('.')}. The steps before" in stopped.value.evidence.sections[0].text
    assert sentence(stopped.value) == f"axis x: major loop: {problem.removesuffix('.')}."
