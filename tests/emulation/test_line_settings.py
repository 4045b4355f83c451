"""A port that is in use, from the device's side."""

import pytest
from testbus.virtual_bus import VirtualLoop

from campaigns.fault_cells import free_port
from micromanip.emulation.devices import Devices
from micromanip.errors import DeviceUnavailable

from .lines import GCS, write_cell


def test_port_in_use(tmp_path):
    file = write_cell(tmp_path, GCS.format(port=f"tcp: {{host: 127.0.0.1, port: {free_port()}}}"))
    first = Devices(file, loop=VirtualLoop())
    try:
        with pytest.raises(DeviceUnavailable, match=r"tcp 127\.0\.0\.1:\d+ can't be opened: Address already in use"):
            Devices(file, loop=VirtualLoop())
    finally:
        first.close()
    Devices(file, loop=VirtualLoop()).close()
