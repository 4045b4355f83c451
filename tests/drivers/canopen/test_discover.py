"""What is found on a CAN bus of which no file says what is on it; the devices' outputs stay."""

import threading

from micromanip_drivers.canbus.driver import CanBus
from micromanip_drivers.canopen.driver import CanOpen

from .cell import cell

EXAMPLE = {"eds": "not/there.eds", "node_id": 9}


def test_nodes_say_who_they_are():
    with cell() as at:
        section = {"driver": "canopen", "interface": "micromanip", "channel": at.channel, "bitrate": 1_000_000}
        device, answers = CanOpen.discover({**section, "nodes": {"device": EXAMPLE}}, 5.0)
        found = {answer.name: answer.values["product_code"] for answer in answers}
    assert device == f"micromanip-{at.channel}"
    assert found == {"node 5": 0x404, "node 6": 0x401}


def test_messages_of_no_database_are_heard_and_nothing_is_sent():
    with cell(amplifier=False) as at:
        section = {"interface": "micromanip", "channel": at.channel, "bitrate": 1_000_000, "database": "not/there.dbc"}
        _, answers = CanBus.discover(section, 1.0)
        before = at.do(lambda: at.at.hub.statistics.frames)
        later = threading.Timer(0.3, lambda: at.at.send(0x123, b"\1\2"))
        later.start()
        [heard] = list(answers)
        later.join()
        assert at.do(lambda: at.at.hub.statistics.frames) == before + 1
    assert (heard.name, heard.values["data"]) == ("message 0x123", "01 02")
