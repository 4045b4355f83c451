"""The driver on the test bus: frames both ways in bus time, bus-off and what comes after, a bus that goes away."""

import os
import time
from pathlib import Path

import cantools
import pytest
from micromanip_drivers.canbus.driver import CanBus, CanBusOptions

from micromanip.bus.errors import LinkError
from micromanip.bus.inbox import Inbox
from micromanip.testbus.faults import BusOff

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


def test_bus_off_is_a_lost_link_and_opening_again_recovers(at, bus):
    at.inject(BusOff())
    assert "bus-off on micromanip-canbus" in until_raised(bus, LinkError)
    bus.close()
    bus.open()
    at.send(0x101, sensors(strain_y=1.0), **FD)
    assert dict(received(bus, len(bus.inputs)))["Sensors.strain_y"].value == pytest.approx(1.0)
    assert bus.statistics()["bus_off"] == 1


def test_the_wrong_bit_rate_is_seen_at_once():
    with (
        bench(f"canbus-rate-{os.getpid()}", data_bitrate=8_000_000) as at,
        pytest.raises(LinkError, match="data_bitrate of 8000000"),
    ):
        driver(at.channel).open()
