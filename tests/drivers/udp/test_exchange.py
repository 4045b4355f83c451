"""The driver `udp` in the loop's hands: what comes becomes samples, what is decided arrives, and nothing steps."""

import math
import random
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest

from micromanip.bus.cyclic import call_context
from micromanip.bus.errors import IdentityMismatch, LinkError
from micromanip.rt.bus_image import DOWN, TAKEN

from .bench import PATIENT_CYCLES, PERIOD_NS, SILENT_CYCLES, STILL_CYCLES, Bench, sealed

pytestmark = [pytest.mark.compiled_only, pytest.mark.xdist_group("udp")]  # compiled by one worker, not by each


@pytest.fixture
def bench():
    with Bench() as found:
        yield found


def values(bench):
    return bench.signals["value"][:3].tolist()


def test_an_answer_becomes_samples(bench):
    bench.follow()
    bench.tracked += 1
    before = bench.signals["sequence"][:3].copy()
    bench.say(strain=12.3456, stage=-7.25, deviation=98.765)
    assert bench.exchange(0, 0) == 0
    assert values(bench) == pytest.approx([12.3456, -7.25, 98.765], abs=1e-12)
    assert (bench.signals["sequence"][:3] - before).tolist() == [1, 1, 1]
    assert bench.signals["status"][:3].tolist() == [0, 0, 0]
    ages_ns = bench.now_ns - bench.signals["time_ns"][:3]
    assert 0 <= ages_ns[0] == ages_ns[1] == ages_ns[2] - 1_000_000


def test_what_is_slower_is_fresh_when_its_counter_says_so(bench):
    bench.follow()
    bench.tracked += 1
    fresh = []
    for k in range(12):
        bench.tracked += k % 4 == 3
        before = bench.signals["sequence"][:3].copy()
        bench.say(deviation=k)
        bench.exchange(0, 0)
        fresh.append((bench.signals["sequence"][:3] - before).tolist())
    assert [each[0] for each in fresh] == [1] * 12
    assert [each[2] for each in fresh] == [1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -20.1, 150.1])
def test_what_may_not_be_sent_stays_as_it_was(bench, bad):
    bench.follow()
    bench.say()
    bench.exchange(3.0, 0)
    bench.say()
    bench.commands()
    assert bench.exchange(bad, 1.0) == 0
    assert bench.commands() == [(pytest.approx(3.0), 1)]
    assert bench.statistics["refused_values"] == 1


@pytest.mark.parametrize(
    ("spoilt", "counter"),
    [
        (lambda good: good[:-1], "wrong_length"),
        (lambda good: good + b"\0", "wrong_length"),
        (lambda good: b"", "wrong_length"),
        (lambda good: good + bytes(3000), "wrong_length"),
        (lambda good: good[:12] + bytes([good[12] ^ 1]) + good[13:], "wrong_checksum"),
        (lambda good: sealed(b"\xa5\x11" + good[2:-4]), "not_this_datagram"),
    ],
)
def test_what_is_damaged_or_another_datagram_is_no_sample(bench, spoilt, counter):
    bench.follow()
    before, counted = bench.signals.copy(), bench.statistics
    bench.say(spoilt(bench.datagram(strain=55.0)))
    bench.exchange(0, 0)
    assert (bench.signals == before).all()
    assert bench.statistics[counter] == counted[counter] + 1


def test_what_others_send_is_no_sample(bench):
    """The kernel drops it; what it lets through, from before the socket was connected, is told by its source."""
    bench.follow()
    before = bench.signals.copy()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(bench.datagram(strain=55.0), bench.controller)
        bench.exchange(0, 0)
    assert (bench.signals == before).all()
    bench.c["socket"]["peer"][3] ^= 1
    bench.say(strain=55.0)
    bench.exchange(0, 0)
    assert (bench.signals == before).all()
    assert bench.statistics["strangers"] == 1


def test_lost_doubled_and_overtaken_datagrams_are_counted(bench):
    bench.follow()
    begin, sequence = bench.count, int(bench.signals[0]["sequence"])
    said = {begin + 4: 4.0, begin + 5: 5.0}
    for count in (begin + 4, begin + 4, begin + 2, begin + 5):
        bench.say(strain=said.get(count, 99.0), count=count)
        bench.exchange(0, 0)
    assert bench.signals[0]["value"] == pytest.approx(5.0)
    assert bench.signals[0]["sequence"] == sequence + 5
    found = bench.statistics
    assert (found["lost"], found["doubled"], found["late"]) == (3, 1, 1)
    assert bench.driver.missing(bench.context)[0] == 3


def test_at_the_beginning_the_outputs_are_at_rest_until_it_answers(bench):
    codes = [bench.exchange(0.0, 0.0)]
    for _ in range(4):
        bench.say()
        codes.append(bench.exchange(0.0, 0.0))
    assert codes == [DOWN, DOWN, DOWN, 0, 0]
    assert set(bench.commands()) <= {(0.0, 0), (0.0, 1)}


def lost(bench, voltage):
    """Follow to `voltage`, then hear nothing until the link counts as lost; what the device was given meanwhile."""
    bench.follow()
    for k in range(11):
        bench.say()
        assert bench.exchange(voltage * k / 10, 0) == 0
    bench.commands()
    codes = [bench.exchange(voltage, 0) for _ in range(SILENT_CYCLES + 1)]
    assert codes == [0] * SILENT_CYCLES + [DOWN]
    return bench.commands()


def test_a_lost_link_leaves_the_device_to_its_watchdog_and_nothing_steps(bench):
    assert lost(bench, 50.0) == [(pytest.approx(50.0), 0)] * PATIENT_CYCLES
    bench.now_ns += (STILL_CYCLES - SILENT_CYCLES + PATIENT_CYCLES - 5) * PERIOD_NS
    assert bench.exchange(50.0, 0) == DOWN
    assert bench.commands() == []
    bench.now_ns += 10 * PERIOD_NS
    codes = []
    for _ in range(5):
        codes.append(bench.exchange(50.0, 0))
        assert bench.commands() == [(0.0, 1)]
        bench.say()
    assert codes == [DOWN, DOWN, DOWN, TAKEN, TAKEN]
    bench.say()
    assert bench.exchange(0.0, 0) == 0
    assert bench.statistics["losses"] == 1


def test_what_comes_while_the_device_goes_to_rest_does_not_bring_it_back(bench):
    lost(bench, 50.0)
    for _ in range(20):
        bench.say()
        assert bench.exchange(50.0, 0) == DOWN
    assert bench.commands() == []


def test_a_loop_that_was_away_for_the_watchdogs_time_takes_the_device_for_lost(bench):
    bench.follow()
    bench.say()
    assert bench.exchange(5.0, 0, periods=50) == 0
    bench.commands()
    bench.say()
    assert bench.exchange(5.0, 0, periods=95) == DOWN
    assert bench.commands() == []


def test_a_device_that_began_anew_is_not_given_what_it_had_before(bench):
    bench.follow()
    bench.count = 3000
    bench.say()
    assert bench.exchange(40.0, 0) == 0
    codes = []
    for count in range(8):
        bench.say(count=count)
        bench.commands()
        codes.append(bench.exchange(40.0, 0))
    assert codes[3:] == [DOWN] * 5
    assert bench.commands() == []
    assert bench.statistics["restarts"] == 1


def test_garbage_changes_no_sample_and_no_output(bench, request):
    bench.follow()
    chance = random.Random(3)
    before, received = bench.signals.copy(), bench.statistics["received"]
    for limit in ("silent_cycles", "patient_cycles", "watchdog_ns"):  # as slow as the machine may be
        bench.c["gate"][limit] = np.iinfo(np.int64).max
    bench.say()
    bench.exchange(7.0, 0)
    before = bench.signals.copy()
    bench.commands()
    rounds = request.config.getoption("--garbage") // 32
    good = bench.datagram(strain=55.0)
    for _ in range(rounds):
        for _ in range(32):
            if chance.random() < 0.5:
                data = bytearray(good)
                for _ in range(chance.randint(1, 4)):
                    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
                data = data[: chance.randint(0, len(data))] if chance.random() < 0.2 else data
                data = b"" if data == good else data
            else:
                data = chance.randbytes(chance.choice((0, 1, len(good), len(good), chance.randint(0, 1600))))
            bench.device.sendto(bytes(data), bench.controller)
        assert bench.exchange(7.0, 0) == 0
        assert bench.commands() == [(pytest.approx(7.0), 0)]
    assert (bench.signals == before).all()
    assert bench.statistics["received"] > received + 31 * rounds


def test_another_device_is_refused():
    numbers = {"serial": {"at": 2, "type": "uint16", "byte_order": "little", "value": 77}}
    bench = Bench(identity={"request": "a5 01", "head": "a5 81", "numbers": numbers})

    def answer(serial):
        data, controller = bench.device.recvfrom(100)
        assert data == sealed(b"\xa5\x01")
        bench.device.sendto(sealed(b"\xa5\x81" + serial.to_bytes(2, "little")), controller)

    with closing(bench), ThreadPoolExecutor(1) as thread:
        thread.submit(answer, 78)
        with pytest.raises(IdentityMismatch, match="serial 78, the configuration says 77"):
            bench.driver.begin(bench.context)
        answered = thread.submit(answer, 77)
        bench.driver.begin(bench.context)
        answered.result()
        with pytest.raises(LinkError, match="nothing answers"):
            bench.driver.begin(bench.driver.context())


def test_a_loop_that_waits_has_the_answer_of_its_own_cycle():
    def answer(bench):
        bench.device.settimeout(10)
        data, controller = bench.device.recvfrom(2048)
        bench.acted_on = int.from_bytes(data[2:4], "little")
        bench.device.sendto(bench.datagram(strain=2.5), controller)

    with Bench(wait_us=70.0) as bench, ThreadPoolExecutor(1) as thread:
        bench.follow()
        bench.commands()
        bench.c["wait_ns"] = 10_000_000_000  # the device is a thread of this process
        bench.now_ns = time.monotonic_ns()
        answered = thread.submit(answer, bench)
        assert bench.exchange(1.0, 0.0) == 0
        assert values(bench)[0] == pytest.approx(2.5), "without waiting: of the cycle before"
        assert bench.c["gate"]["acknowledged"] == bench.c["gate"]["sent_count"]
        answered.result()


def test_the_host_sees_that_the_device_rests(bench):
    """It waits for the watchdog, sends nothing but the safe values, and believes no silence."""
    bench.follow()
    bench.say()
    bench.exchange(30.0, 0)
    bench.c["gate"]["sent_ns"] = time.monotonic_ns()
    bench.commands()
    safe = bench.driver.safe_in_host()
    begin = time.monotonic()
    assert safe(bench.context) == 1
    assert time.monotonic() - begin >= 0.015
    commands = bench.commands()
    assert commands
    assert set(commands) == {(0.0, 1)}


def test_safe_waits_for_the_watchdog(bench):
    begin_ns = time.monotonic_ns()
    bench.c["gate"]["sent_ns"] = begin_ns
    assert call_context(bench.driver.functions().safe, bench.context.ctypes.data) == 0
    assert time.monotonic_ns() - begin_ns >= 15_000_000
    assert bench.exchange(0, 0) == 1


def test_the_plain_codec_says_the_same(bench):
    """What `probe` and the host go by reads and writes what the loop does."""
    bench.follow()
    bench.tracked += 1
    said = bench.datagram(strain=-3.2101, stage=1.5, deviation=-0.007, status=3)
    bench.say(said)
    bench.exchange(21.0007, 1)
    datagrams = bench.driver._datagrams
    assert list(datagrams.values(said).values()) == values(bench)
    assert datagrams.status(said) == bench.signals[0]["status"] == 0
    sent = bench.c["socket"]["sent"][: datagrams.sent_bytes].tobytes()
    count = int.from_bytes(sent[2:4], "little")
    assert datagrams.frame([21.0007, 1], count) == sent
