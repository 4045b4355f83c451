"""Times of synchronous samples, by numbers: SYNC each 1000 us, frames of 115 us."""

from micromanip_drivers.canopen.sampling import Sampling, SyncTimes

US = 1_000
PERIOD, FRAME, LATENCY, WAITING = 1000 * US, 115 * US, 40 * US, 300 * US


def sampling(every=1):
    syncs = SyncTimes()
    return syncs, Sampling(syncs, every, FRAME, LATENCY, PERIOD, WAITING)


def test_taken_at_the_sync_however_long_it_waited():
    syncs, at = sampling()
    syncs.add(0)
    assert at.taken(170 * US, b"a") == (-LATENCY, 0)
    syncs.add(PERIOD)
    assert at.taken(PERIOD + 700 * US, b"b") == (PERIOD - LATENCY, 0)


def test_a_frame_that_began_before_the_sync_answers_the_one_before():
    syncs, at = sampling()
    syncs.add(0)
    syncs.add(PERIOD)
    assert at.taken(PERIOD + FRAME - 1, b"a") == (-LATENCY, 0)


def test_a_late_sync_and_the_next_one_are_answered_in_their_order():
    syncs, at = sampling()
    syncs.add(900 * US)
    syncs.add(1000 * US)
    assert at.taken(1250 * US, b"a") == (900 * US - LATENCY, 0)
    assert at.taken(1480 * US, b"a") == (1000 * US - LATENCY, 0)


def test_syncs_without_an_answer_are_lost_samples():
    syncs, at = sampling()
    for i in range(5):
        syncs.add(i * PERIOD)
        if i in (0, 4):
            taken = at.taken(i * PERIOD + 200 * US, b"a")
    assert taken == (4 * PERIOD - LATENCY, 3)


def test_an_answer_is_not_dated_by_a_lost_sync_that_was_sent_late():
    """The SYNC before was sent 300 us late and not answered: it is within a period of the answer to the next."""
    syncs, at = sampling()
    syncs.add(0)
    assert at.taken(170 * US, b"a") == (-LATENCY, 0)
    syncs.add(1300 * US)
    for i in (2, 3, 4):
        syncs.add(i * PERIOD)
        assert at.taken(i * PERIOD + 170 * US, b"a") == (i * PERIOD - LATENCY, 1 if i == 2 else 0)


def test_a_slow_node_is_known_by_its_fastest_answer():
    syncs, at = sampling()
    syncs.add(0)
    assert at.taken(900 * US, b"a") == (-LATENCY, 0)
    syncs.add(1500 * US)
    syncs.add(2000 * US)
    assert at.taken(1500 * US + 900 * US, b"a") == (1500 * US - LATENCY, 0)


def test_the_same_again_is_no_sample_and_another_is_dated_by_its_arrival():
    syncs, at = sampling()
    syncs.add(0)
    assert at.taken(170 * US, b"a") == (-LATENCY, 0)
    assert at.taken(290 * US, b"a") is None
    assert at.taken(400 * US, b"b") == (400 * US - FRAME - LATENCY, 0)


def test_without_a_sync_lately():
    syncs, at = sampling()
    assert at.taken(500 * US, b"a") == (500 * US - FRAME - LATENCY, 0)
    syncs.add(1000 * US)
    assert at.taken(9000 * US, b"a") == (9000 * US - FRAME - LATENCY, 0)


def test_reopened():
    syncs, at = sampling()
    syncs.add(0)
    at.taken(170 * US, b"a")
    syncs.clear()
    at.clear()
    for i in range(50, 60):
        syncs.add(i * PERIOD)
    assert at.taken(59 * PERIOD + 170 * US, b"a") == (59 * PERIOD - LATENCY, 0)
