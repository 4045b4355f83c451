"""A lease runs out in silence, and not while the host is held up."""

import pytest

from micromanip.host.control.moving import Lease


class Clock:
    """A time that stands until it is moved on."""

    now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def looks(lease, clock, every_s):
    """How often it is looked at until it has run out."""
    for count in range(1, 1000):
        clock.now_s += every_s
        if lease.ran_out():
            return count
    pytest.fail("it never ends")


@pytest.mark.parametrize(("every_s", "count"), [(0.05, 21), (0.08, 13), (0.5, 11)])
def test_it_runs_out_in_silence(clock, every_s, count):
    """However rarely it is looked at: half a second counts for two looks."""
    assert looks(Lease(1.0, 0.05, clock), clock, every_s) == pytest.approx(count, abs=1)


def test_each_question_begins_it_anew(clock):
    lease = Lease(1.0, 0.05, clock)
    for k in range(100):
        clock.now_s += 0.05
        assert not lease.ran_out()
        if k % 15 == 0:
            lease.renew()
    assert looks(lease, clock, 0.05) <= 21


def test_a_host_that_was_held_up_ends_nothing_by_that(clock):
    """Ten seconds without a turn, while the client's question waits in the socket."""
    lease = Lease(1.0, 0.05, clock)
    for _ in range(8):
        clock.now_s += 0.05
        assert not lease.ran_out()
    clock.now_s += 10.0
    assert not lease.ran_out()
    lease.renew()
    assert looks(lease, clock, 0.05) == pytest.approx(21, abs=1)
