"""Devices with habits of their own: interleavings in virtual time, and what played devices do by themselves."""

import socket
import time

import pytest

from campaigns.oracle import Arrivals
from campaigns.played.amplifier import Amplifier, Habits
from campaigns.played.lines import Gcs
from campaigns.played.port import TcpPort
from campaigns.virtual_worker import interleaved
from tests.further import further


@pytest.mark.long
@pytest.mark.parametrize("first", [0, *further(*range(5, 250, 5))])
def test_no_interleaving_in_virtual_time_breaks_a_rule(tmp_path, first):
    for number in range(first, first + 5):
        played = interleaved(1, number, tmp_path)
        assert not played.broken, played.line


def said(link, *lines):
    link.sendall("".join(f"{line}\n" for line in lines).encode())
    return link.makefile().readline()


@pytest.mark.live  # a device's own time
def test_a_played_device_has_its_own_watchdog_and_power(request):
    amplifier = Amplifier(Habits(watchdog_ms=100.0, latches=True), arrivals := Arrivals())
    port = TcpPort(amplifier, Gcs)
    request.addfinalizer(port.close)
    with socket.create_connection(("127.0.0.1", port.place), 5) as link:
        assert said(link, "SVA 1 5.0", "ERR?") == "0\n"
        while not amplifier.latched:
            time.sleep(0.01)
        assert said(link, "SVA 1 5.0", "ERR?") == "5\n"
        amplifier.switch(False)
        amplifier.switch(True)
        amplifier.habits = Habits()
        with pytest.raises(ConnectionResetError):
            said(link, *["ERR?"] * 1000)
    with socket.create_connection(("127.0.0.1", port.place), 5) as link:
        assert said(link, "SVA 1 3.0", "SVA? 1") == "1=3.0000\n"
        amplifier.fails = "nan"
        assert said(link, "POS? 1") == "1=nan\n"
        port.cut("late")
        link.sendall(b"SVA 1 4.0\n")
        time.sleep(0.05)
        assert amplifier.volts()["voltage_x"] == 3.0
        port.mend()
        assert said(link, "ERR?") == "0\n"
    own = [(each.volts, each.itself) for each in arrivals.copy() if each.name == "voltage_x"]
    assert own[:5] == [(0.0, True), (5.0, False), (0.0, True), (5.0, True), (3.0, False)]
