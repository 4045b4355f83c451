"""The conformance suite finds what it looks for: a good driver passes, and each check has drivers that it must fail."""

import pytest
from _pytest.outcomes import Skipped

from conformance.broken import description, lifetime, link, reading, writing
from micromanip.bus.driver import Outcome
from micromanip.bus.errors import LinkError, TransientError

from .broken import BROKEN
from .example import UdpPeer, UdpStage, UdpStageContract

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


class AnsweredLate(UdpStage):
    """The answer to its first write does not come in time, and it says so."""

    waits, late = False, 1

    def perform(self, task, values, inbox):
        super().perform(task, values, inbox)
        self.waits = self.late > 0
        return Outcome.SENT if self.waits else None

    def receive(self, inbox, until_ns):
        super().receive(inbox, until_ns)
        if self.waits:
            self.waits, self.late = False, self.late - 1
            raise TransientError("no answer within 30 ms")


class LosesLinkLate(UdpStage):
    """Sees that its device was silent when the silence has just ended."""

    sees = False

    def receive(self, inbox, until_ns):
        super().receive(inbox, until_ns)
        if LosesLinkLate.sees:
            LosesLinkLate.sees = False
            raise LinkError("nothing came for 500 ms")


class LosesLinkOnce(UdpStage):
    """Its device stands still for too long, once."""

    calls = 0

    def receive(self, inbox, until_ns):
        super().receive(inbox, until_ns)
        LosesLinkOnce.calls += 1
        if LosesLinkOnce.calls == 50:
            raise LinkError("no answer, three times")


class SilentPeer(UdpPeer):
    def silence(self, silent):
        super().silence(silent)
        LosesLinkLate.sees = not silent


@pytest.mark.parametrize(
    ("driver", "check"),
    [
        (AnsweredLate, "test_what_is_said_of_a_write_is_true"),
        (LosesLinkLate, "test_silent_device_is_no_bug"),
        (LosesLinkOnce, "test_load_is_at_most_what_is_declared"),
    ],
)
def test_a_device_that_a_busy_machine_holds_up_is_not_held_against_its_driver(driver, check):
    suite = type("Suite", (UdpStageContract,), {"driver": driver, "peer": lambda _: SilentPeer()})()
    getattr(suite, check)()
