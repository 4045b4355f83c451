"""The conformance suite finds what it looks for: a good driver passes, and each check has drivers that it must fail."""

import pytest
from _pytest.outcomes import Skipped

from conformance.broken import description, lifetime, link, reading, writing

from .broken import BROKEN
from .example import UdpStageContract

pytestmark = pytest.mark.live  # a driver and its device side by side, and time-outs

MODULES = (description, lifetime, link, reading, writing)
CHECKS = [name for name in dir(UdpStageContract) if name.startswith("test_")]


class TestGoodDriver(UdpStageContract):
    """All checks on the driver that the others are made of."""


@pytest.mark.parametrize(
    ("driver", "check", "changed"), BROKEN, ids=[f"{driver.__name__}-{check}" for driver, check, _ in BROKEN]
)
def test_broken_driver_is_found(driver, check, changed):
    suite = type("Suite", (UdpStageContract,), {"driver": driver, **changed})()
    try:
        with pytest.raises(AssertionError) as found:
            getattr(suite, check)()
    except Skipped as skipped:
        pytest.fail(f"skipped: {skipped}")
    finally:
        getattr(driver, "tidy", lambda: None)()
    assert "\n" not in str(found.value), "a finding is one sentence"


@pytest.mark.parametrize("check", CHECKS)
def test_every_check_has_a_driver_that_it_finds(check):
    assert check in {found for _, found, _ in BROKEN}
