"""What is wrong in a configuration, from the devices' side: one sentence each, with file, line and key."""

import re

import pytest
from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.devices import Devices
from micromanip.errors import ConfigError, DeviceUnavailable

from .emulated import configuration

WRONG = {
    "no plant": (("simulation:", "control: {}\nxsimulation:"), r"unknown key xsimulation"),
    "typo in the plant": (("  lines: {}", "  linse: {}"), r":\d+: simulation\.linse: unknown key linse: did you mean"),
    "plant that isn't there": (
        ("  lines: {}", "  lines: {}\n  driver: simulatd"),
        r":\d+: simulation\.driver: no driver called simulatd is installed; did you mean simulated\?",
    ),
    "no lines": (("  lines: {}", ""), r":\d+: signals\.enable: the simulated plant has no enable.*lines: \{\}"),
    "axis less": (
        ("    z: {preisach_d", "  axes: [x, y]\n  # {preisach_d"),
        r":\d+: signals\.strain_z: the simulated plant has no strain_z.*did you mean",
    ),
    "no device": (
        ("driver: canbus", "driver: simulated"),
        r":\d+: drivers: none of them has a device to emulate",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_says_where_and_what(name, tmp_path):
    change, said = WRONG[name]
    with pytest.raises(ConfigError) as caught:
        Devices(configuration(tmp_path, change), loop=VirtualLoop())
    assert re.search(said, str(caught.value)), caught.value


def test_no_section_says_what_to_write(tmp_path):
    file = configuration(tmp_path)
    text = file.read_text()
    file.write_text(text[: text.index("\nsimulation:")])
    with pytest.raises(ConfigError, match=r"there is no section simulation.*`simulation: \{\}`"):
        Devices(file, loop=VirtualLoop())


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
