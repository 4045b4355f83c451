"""What is wrong in a configuration of a line, from the device's side: one sentence each, with file, line and key."""

import re

import pytest
from testbus.virtual_bus import VirtualLoop

from micromanip.emulation.devices import Devices
from micromanip.errors import ConfigError, DeviceUnavailable

from .lines import BOARD, CAPACITIVE, GCS, free_port, write_cell

WRONG = {
    "two ports": (
        BOARD,
        ("    serial:", "    tcp: {host: localhost, port: 1}\n    serial:"),
        "give one port, .* there are serial and tcp",
    ),
    "no framing": (BOARD, ("    binary:", "    bnary:"), "unknown key bnary: did you mean binary"),
    "no such reply": (
        BOARD,
        ("reply: monitor", "reply: monitr"),
        "binary.receive has no monitr; it has strains, monitor",
    ),
    "no baud": (BOARD, (", baud: 4000000", ""), "baud: missing"),
    "no block": (CAPACITIVE, ("      block_bytes: 8\n", ""), "block_bytes: missing"),
}


@pytest.mark.parametrize("name", WRONG)
def test_says_where_and_what(name, tmp_path):
    text, (old, new), said = WRONG[name]
    port = free_port()
    text = text.format(
        device=tmp_path / "tty", port=1 if text is CAPACITIVE else f"tcp: {{host: 127.0.0.1, port: {port}}}"
    )
    assert old in text
    with pytest.raises(ConfigError) as caught:
        Devices(write_cell(tmp_path, text.replace(old, new)), loop=VirtualLoop())
    assert re.search(said, str(caught.value)), caught.value
    assert re.search(r"cell\.yaml:\d+", str(caught.value))
    assert not (tmp_path / "tty").is_symlink(), "nothing is left behind"


def test_port_in_use(tmp_path):
    file = write_cell(tmp_path, GCS.format(port=f"tcp: {{host: 127.0.0.1, port: {free_port()}}}"))
    first = Devices(file, loop=VirtualLoop())
    try:
        with pytest.raises(
            DeviceUnavailable, match=r"tcp 127\.0\.0\.1:\d+ can't be listened on: Address already in use"
        ):
            Devices(file, loop=VirtualLoop())
    finally:
        first.close()
    Devices(file, loop=VirtualLoop()).close()
