"""The driver on the test bus: frames both ways in bus time, bus-off and what comes after, a bus that goes away."""

import os
import time
from pathlib import Path

import cantools
import pytest
from micromanip_drivers.canbus.driver import CanBus, CanBusOptions

from micromanip.bus.errors import LinkError, TransientError
from micromanip.bus.inbox import Inbox
from micromanip.testbus.faults import Babble, BusOff, ErrorPassive

from .hub_in_thread import BITRATE, DATA_BITRATE, bench

FOLDER = Path(__file__).parents[3] / "config"
DATABASE = cantools.database.load_file(FOLDER / "can/manipulator.dbc")
SENSORS = DATABASE.get_message_by_name("Sensors")
REST = dict.fromkeys((signal.name for signal in SENSORS.signals), 0)
FD = {"fd": True, "bitrate_switch": True}


def driver(channel):
    options = CanBusOptions(
        interface="micromanip",
        channel=channel,
        bitrate=BITRATE,
        data_bitrate=DATA_BITRATE,
        database="can/manipulator.dbc",
        silence_ms=None,
        receive={"Sensors": {"rate_hz": 2000.0, "counter": "Count"}},
        send={"Voltages": {"rate_hz": 2000.0, "counter": "Count"}},
    )
    return CanBus(options, FOLDER)


@pytest.fixture
def at():
    with bench(f"canbus-{os.getpid()}") as at:
        yield at


@pytest.fixture
def bus(at):
    bus = driver(at.channel)
    bus.open()
    yield bus
    bus.close()


def sensors(**values):
    return SENSORS.encode(REST | values)


def received(bus, samples, seconds=2.0):
    """Values by channel once so many samples came."""
    inbox = Inbox()
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    while len(inbox) < samples and time.monotonic_ns() < end_ns:
        bus.receive(inbox, end_ns)
    return [(bus.inputs[sample.channel].name, sample) for sample in inbox]


def until_raised(bus, error, seconds=2.0):
    end_ns = time.monotonic_ns() + round(seconds * 1e9)
    try:
        while time.monotonic_ns() < end_ns:
            bus.receive(Inbox(), end_ns)
    except error as raised:
        return str(raised)
    pytest.fail(f"no {error.__name__}")


def descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


def test_samples_come_with_the_time_of_the_frame_on_the_bus(at, bus):
    before_ns = time.monotonic_ns()
    at.send(0x101, sensors(strain_x=12.5, stage_z=-3.25, Count=9), **FD)
    samples = dict(received(bus, len(bus.inputs)))
    assert samples["Sensors.strain_x"].value == pytest.approx(12.5)
    assert samples["Sensors.stage_z"].value == pytest.approx(-3.25)
    # taken when the frame began, so before its 89 us on the bus
    assert before_ns - 100_000 <= samples["Sensors.strain_x"].time_ns <= time.monotonic_ns()


def test_commands_arrive_and_count(at, bus):
    for value in (1.0, 2.0, 3.0):
        bus.perform(0, [value, 0.0, 150.0, 1.0, 0.0, 1.0], Inbox())
    frames = [at.device.heard.get(timeout=2)[0] for _ in range(3)]
    decoded = [DATABASE.decode_message("Voltages", frame.data) for frame in frames]
    assert [values["voltage_x"] for values in decoded] == pytest.approx([1.0, 2.0, 3.0], abs=0.0014)
    assert [values["Count"] for values in decoded] == [0, 1, 2]
    assert [(frame.identifier, frame.fd, frame.bitrate_switch) for frame in frames] == [(0x100, True, True)] * 3


def test_a_full_queue_passes_and_leaves_no_gap_in_the_counter(at, bus):
    sent = refused = 0
    end_ns = time.monotonic_ns() + 2_000_000_000
    while not (refused and sent >= 50) and time.monotonic_ns() < end_ns:
        try:
            bus.perform(0, [0.0] * 6, Inbox())
            sent += 1
        except TransientError:
            refused += 1
    counts = [at.device.heard.get(timeout=2)[0].data[7] for _ in range(sent)]
    assert counts == [k % 256 for k in range(sent)]
    assert bus.statistics()["transmit_full"] == refused > 0


def test_bus_off_is_a_lost_link_and_opening_again_recovers(at, bus):
    at.inject(BusOff())
    assert "bus-off on micromanip-canbus" in until_raised(bus, LinkError)
    bus.close()
    bus.open()
    at.send(0x101, sensors(strain_y=1.0), **FD)
    assert dict(received(bus, len(bus.inputs)))["Sensors.strain_y"].value == pytest.approx(1.0)
    assert bus.statistics()["bus_off"] == 1


def test_error_passive_is_counted_and_no_reason_to_stop(at, bus):
    at.inject(ErrorPassive())
    at.send(0x101, sensors(), **FD)
    assert received(bus, len(bus.inputs))
    assert bus.statistics()["error_passive"] == 1


def test_a_babbling_node_does_not_keep_it_from_returning(at, bus):
    at.inject(Babble(identifier=1))
    end_ns = time.monotonic_ns() + 2_000_000_000
    while not bus.statistics()["not_ours"]:
        bus.receive(Inbox(), time.monotonic_ns() + 2_000_000)
        assert time.monotonic_ns() < end_ns
    for _ in range(3):
        bus.receive(Inbox(), time.monotonic_ns() + 2_000_000)


def test_a_bus_that_goes_away_is_a_lost_link():
    with bench(f"canbus-gone-{os.getpid()}") as at:
        bus = driver(at.channel)
        bus.open()
    assert "receiving" in until_raised(bus, LinkError)
    with pytest.raises(LinkError, match="sending"):
        bus.perform(0, [0.0] * 6, Inbox())
    bus.close()
    with pytest.raises(LinkError, match="no hub"):
        bus.open()


def test_the_wrong_bit_rate_is_seen_at_once():
    with (
        bench(f"canbus-rate-{os.getpid()}", data_bitrate=8_000_000) as at,
        pytest.raises(LinkError, match="data_bitrate of 8000000"),
    ):
        driver(at.channel).open()


def test_opened_and_closed_a_hundred_times_nothing_is_left_open(at):
    bus = driver(at.channel)
    bus.open()
    bus.close()
    before = descriptors()
    for _ in range(100):
        bus.open()
        bus.close()
    end_ns = time.monotonic_ns() + 2_000_000_000  # until the bus has seen that they are gone
    while descriptors() > before and time.monotonic_ns() < end_ns:
        time.sleep(0.01)
    assert descriptors() <= before
