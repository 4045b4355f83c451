"""Every fault that can be injected: what it does to the frames, that it ends, and that a seed repeats it."""

import errno

import pytest

from micromanip.errors import UsageError
from micromanip.testbus.faults import Babble, Burst, BusOff, Delay, Drop, Duplicate, Enobufs, Reorder, parsed
from micromanip.testbus.frame import Frame

from .virtual_bus import message, received, sent_until_refused

PERIOD_S = 1e-4


def send_each_period(bus, sender, count, identifier=0x100):
    """A frame each 100 us, numbered; 75 bits long."""
    for number in range(count):
        bus.hub.send(sender, Frame(identifier, number.to_bytes(2, "little")))
        bus.run(PERIOD_S)


def numbers(listener):
    return [int.from_bytes(frame.data, "little") for _, frame in listener.got]


@pytest.fixture
def sender(bus):
    return bus.node()


@pytest.fixture
def listener(bus):
    return bus.node()


def test_dropped_frames_are_missing_by_their_share_and_only_while_it_lasts(bus, sender, listener):
    bus.hub.faults.inject(Drop(share=0.1, for_s=0.1))
    send_each_period(bus, sender, 2000)
    got = numbers(listener)
    assert sorted(got) == got
    assert 60 <= 1000 - sum(number < 1000 for number in got) <= 140  # 100 of 1000, within 4 sigma
    assert got[-1000:] == list(range(1000, 2000))
    assert bus.hub.statistics.frames == 2000  # they were on the bus all the same


def test_the_same_seed_drops_the_same_frames(make_bus):
    def dropped(seed):
        bus = make_bus(seed=seed)
        sender, listener = bus.node(), bus.node()
        bus.hub.faults.inject(Drop(share=0.5))
        send_each_period(bus, sender, 100)
        return numbers(listener)

    assert dropped(1) == dropped(1) != dropped(2)


def test_jitter_keeps_the_order_and_its_bounds_and_nothing_overtakes_at_its_end(bus, sender, listener):
    bus.hub.faults.inject(Delay(delay_s=0.001, jitter_s=0.001, for_s=0.01))
    send_each_period(bus, sender, 150)
    bus.run(0.01)
    assert numbers(listener) == list(range(150))
    late_ns = [time_ns - (75_000 + n * 100_000) for n, time_ns in enumerate(listener.times_ns)]
    assert all(1_000_000 <= late <= 2_000_000 for late in late_ns[:99])
    assert len(set(late_ns[:99])) > 10
    assert late_ns[-20:] == [0] * 20


def test_nothing_overtakes_what_was_delayed_when_the_loop_wakes_late(bus, sender, listener):
    bus.hub.faults.inject(Delay(delay_s=200e-6, for_s=60e-6))
    for identifier in (1, 2, 3, 4, 5):
        bus.hub.send(sender, Frame(identifier))  # the first ends in time to be delayed, to 255 us; the fifth at 275 us
    bus.run(120e-6)
    bus.loop.time_ns += 200_000
    bus.run(0.001)
    assert listener.identifiers == [1, 2, 3, 4, 5]
    assert listener.times_ns == [255_000] * 4 + [275_000]


def test_duplicates_are_sent_twice_over_the_wire(bus, sender, listener):
    bus.hub.faults.inject(Duplicate(share=1.0))
    for identifier in (1, 2):
        bus.hub.send(sender, Frame(identifier))
    bus.run(0.001)
    assert listener.identifiers == [1, 1, 2, 2]
    assert listener.times_ns == [55_000 * n for n in (1, 2, 3, 4)]


def test_neighbours_change_places_and_none_is_kept_for_ever(bus, sender, listener):
    bus.hub.faults.inject(Reorder(share=1.0, for_s=0.00045))
    send_each_period(bus, sender, 7)
    assert numbers(listener) == [1, 0, 3, 2, 4, 5, 6]


def test_a_burst_holds_frames_back_and_lets_them_all_go_at_once(bus, sender, listener):
    bus.hub.faults.inject(Burst(hold_s=0.001))
    send_each_period(bus, sender, 30)
    bus.run(0.002)
    assert numbers(listener) == list(range(30))
    assert sorted(set(listener.times_ns)) == [1_075_000, 2_075_000, 3_075_000]  # a millisecond after the first


def test_a_babbling_node_lets_nobody_in_as_long_as_it_lasts(bus, sender, listener):
    bus.hub.faults.inject(Babble(for_s=0.01))
    for _ in range(5):
        bus.hub.send(sender, Frame(0x001))
    bus.run(0.0095)
    assert set(listener.identifiers) == {0}
    assert len(listener.got) == 9500 // 135
    bus.run(0.002)
    assert listener.identifiers[-5:] == [1] * 5
    frames = len(listener.got)
    bus.run(0.01)
    assert len(listener.got) == frames


def test_a_full_transmit_queue_fills_the_client_up_and_lets_go_again(bus, listener):
    client = bus.client()
    bus.hub.faults.inject(Enobufs(for_s=0.01))
    bus.run(0)
    sent, full = sent_until_refused(client)
    bus.run(0.005)
    assert sent_until_refused(client)[0] == 0
    assert full.error_code == errno.ENOBUFS
    assert listener.got == []
    bus.run(0.02)
    assert len(listener.got) == sent
    client.send(message())
    bus.run(0.001)
    assert len(listener.got) == sent + 1


def test_a_client_fault_strikes_only_its_process(bus):
    client = bus.client()
    process = next(iter(bus.hub.clients)).process_id
    with pytest.raises(UsageError, match=f"process {process + 1} is not connected"):
        bus.hub.faults.inject(BusOff(client=process + 1))
    bus.run(0.001)
    assert received(client) == ([], [])
    bus.hub.faults.inject(BusOff(client=process))
    assert len(received(client)[1]) == 1


def test_faults_act_together_and_are_cleared_together(bus, sender, listener):
    bus.hub.faults.inject(Delay(delay_s=0.002))
    bus.hub.faults.inject(Drop(identifier=0x101))
    bus.hub.faults.inject(Babble(identifier=0x7FF))
    send_each_period(bus, sender, 1, 0x100)
    send_each_period(bus, sender, 1, 0x101)
    bus.run(0.003)
    assert listener.identifiers.count(0x100) == 1
    assert 0x101 not in listener.identifiers
    bus.hub.faults.clear()
    bus.run(0.003)
    listener.got.clear()
    send_each_period(bus, sender, 1, 0x101)
    assert listener.identifiers == [0x101]


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ({"kind": "drop", "share": 2}, "fault drop share: .*less than or equal to 1"),
        ({"kind": "drop", "shares": 0.1}, "fault drop shares: .*not permitted"),
        ({"kind": "drop", "for_s": 0}, "fault drop for_s: .*greater than 0"),
        ({"kind": "explode"}, "fault: .*'explode'.*'drop'"),
        ({"share": 0.1}, "fault: .*kind"),
        ([], "fault: .*"),
        ({"kind": "burst"}, "fault burst hold_s: .*required"),
        ({"kind": "delay", "delay_s": float("nan")}, "fault delay delay_s: .*finite"),
        ({"kind": "drop", "for_s": float("inf")}, "fault drop for_s: .*finite"),
    ],
)
def test_what_is_wrong_with_a_mapping_is_said_in_one_sentence(document, said):
    with pytest.raises(UsageError, match=said) as refused:
        parsed(document)
    assert "\n" not in str(refused.value)
