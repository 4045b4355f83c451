"""Channels that are in use, and interfaces that nothing can be played on."""

import pytest
from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.devices import Devices
from micromanip.errors import DeviceUnavailable

from .emulated import configuration


def test_channel_in_use(tmp_path):
    file = configuration(tmp_path)
    first = Devices(file, loop=VirtualLoop())
    try:
        with pytest.raises(DeviceUnavailable, match="simulated by another process already"):
            Devices(file, loop=VirtualLoop())
    finally:
        first.close()
    Devices(file, loop=VirtualLoop()).close()


@pytest.mark.parametrize("interface", ["socketcan", "virtual"])
def test_interface_that_can_not_be_played_on(tmp_path, interface):
    with pytest.raises(DeviceUnavailable, match=f"^{interface} played-.* can't be (opened|waited for)"):
        Devices(configuration(tmp_path, ("interface: micromanip", f"interface: {interface}")), loop=VirtualLoop())
