"""A network interface that can't be used: what is said of it."""

import pytest
from micromanip_drivers.canbus import socketcan
from micromanip_drivers.canbus.socketcan import trouble


@pytest.fixture
def network(tmp_path, monkeypatch):
    monkeypatch.setattr(socketcan, "NETWORKS", tmp_path)

    def add(name, **files):
        (tmp_path / name).mkdir()
        for file, text in ({"type": "280", "flags": "0x41", "carrier": "1", "mtu": "72"} | files).items():
            (tmp_path / name / file).write_text(text + "\n")

    return add


@pytest.mark.parametrize(
    ("files", "words"),
    [
        (
            {"flags": "0x40"},
            r"can0 is down; as root: ip link set can0 up type can bitrate 1000000 dbitrate 5000000 fd on",
        ),
        ({"carrier": "0"}, r"can0 is bus-off; as root: ip link set can0 type can restart "),
        (
            {"mtu": "16"},
            r"can0 has no CAN FD; as root: ip link set can0 down, then ip link set can0 up type can bitrate",
        ),
        ({"type": "1"}, r"the network interface can0 is not a CAN bus"),
    ],
)
def test_what_is_wrong_and_what_to_do(network, files, words):
    network("can0", **files)
    assert words in trouble("can0", 1_000_000, 5_000_000)
