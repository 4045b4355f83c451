"""Probing a bus: who speaks, how often, and what it says; nothing is ever sent."""

import time
from pathlib import Path

import can
import cantools
import pytest
from micromanip_drivers.canbus.database import Database
from micromanip_drivers.canbus.sniff import sniff

FOLDER = Path(__file__).parents[3] / "config/can"
SENSORS = cantools.database.load_file(FOLDER / "manipulator.dbc").get_message_by_name("Sensors")


class Overheard:
    """A link on which some frames come, and that can't send."""

    def __init__(self, frames):
        self.frames = frames
        self.is_open = False

    def open(self):
        self.is_open = True

    def close(self):
        self.is_open = False

    def receive(self, until_ns):
        if not self.frames:
            time.sleep(max(0.0, (until_ns - time.monotonic_ns()) * 1e-9))
        frames, self.frames = self.frames, []
        return [(frame, 0) for frame in frames]


def frame(identifier, data, extended=False):
    return can.Message(arbitration_id=identifier, data=data, is_fd=len(data) > 8, is_extended_id=extended)


def answers(*frames, database=FOLDER / "manipulator.dbc"):
    link = Overheard(list(frames))
    found = list(sniff(link, Database(database).by_identifier(), 0.05))
    assert not link.is_open
    return found


def test_known_messages_are_decoded_and_their_rate_is_told():
    rest = dict.fromkeys((signal.name for signal in SENSORS.signals), 0)
    data = [SENSORS.encode(rest | {"strain_x": value}) for value in (1.0, 2.0, 7.0)]
    [answer] = answers(*(frame(0x101, one) for one in data))
    assert answer.name == "message 0x101"
    assert answer.note == "Sensors"
    assert answer.values["strain_x"] == pytest.approx(7.0)
    assert answer.values["rate_hz"] == pytest.approx(60.0)
    assert answer.values["fd"] is True
