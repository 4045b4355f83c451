"""The driver `canbus` on vcan0, and what the scenarios do with it."""

import time

import cantools
from micromanip_drivers.canbus.driver import CanBus

from micromanip.bus.inbox import Inbox

from .vcan import CHANNEL
from .vm_cell import FRAMES

LINK = {"interface": "socketcan", "channel": CHANNEL, "bitrate": 1_000_000}
SPEAKS_WHEN_ASKED = {"silence_ms": None}
FD = {"database": "manipulator.dbc", "data_bitrate": 5_000_000}
CLASSIC = {"database": "classic.dbc"}
PATIENCE_NS = 60_000_000_000


def message_of(database, name):
    """A message as cantools has it."""
    return cantools.database.load_file(FRAMES / database).get_message_by_name(name)


def driver(database, received="Sensors", **options):
    """One that sends Voltages and receives `received`."""
    keys = LINK | SPEAKS_WHEN_ASKED | options
    messages = {
        "receive": {received: {"rate_hz": 100, "counter": "Count", "latency_us": 0}},
        "send": {"Voltages": {"rate_hz": 100, "counter": "Count"}},
    }
    return CanBus(CanBus.Options.model_validate(keys | messages | {"database": database}), FRAMES)


def at_rest(bus):
    """Voltages, and whatever else it sends, all 0."""
    return [0.0] * len(bus.outputs)


def patiently():
    """Until when to wait for what must come."""
    return time.monotonic_ns() + PATIENCE_NS


def taken(bus):
    """The next samples, as soon as there are any."""
    inbox = Inbox()
    end_ns = patiently()
    while not len(inbox) and time.monotonic_ns() < end_ns:
        bus.receive(inbox, end_ns)
    return list(inbox)


def seen_empty(bus):
    """A moment from which on nothing is left that came before it."""
    inbox = Inbox()
    while True:
        moment = time.monotonic_ns()
        inbox.clear()
        bus.receive(inbox, moment)
        if not len(inbox):
            return moment


def sensors(count, **values):
    """The message Sensors as `cansend` takes it, and the values that it carries, by cantools."""
    message = message_of("manipulator.dbc", "Sensors")
    data = message.encode({signal.name: 0 for signal in message.signals} | {"Count": count} | values)
    return f"101##1{data.hex()}", message.decode(data, decode_choices=False)
