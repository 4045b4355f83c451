"""What a device's name leads to, and whether something real may be there."""

import os
import socket

import pytest

from micromanip.bus import device_identity
from micromanip.bus.device_identity import identities, identity, real_because


def test_names_that_lead_to_the_same_device_share_an_identity(tmp_path):
    (tmp_path / "link").symlink_to("device")
    assert identities(str(tmp_path / "link")) == {str(tmp_path / "link"), str(tmp_path / "device")}
    assert identity(str(tmp_path / "link")) == str(tmp_path / "device")
    for name in ("localhost", "127.0.0.1", "::1", "[::1]", "::ffff:127.0.0.1", "0.0.0.0"):
        assert identity(f"tcp {name}:502") == "tcp loopback:502"
    assert identities("tcp 192.0.2.1:502") == {"tcp 192.0.2.1:502"}
    assert identities("tcp no-such-host.invalid:502") == {"tcp no-such-host.invalid:502"}
    assert identities("bench") == {"bench"}
    assert identities("socketcan-lo") == {"socketcan-lo", f"interface {socket.if_nametoindex('lo')}"}
    assert identities("socketcan-nosuchcan0") == {"socketcan-nosuchcan0"}
    assert identities("ethercat lo") == {"ethercat lo", f"interface {socket.if_nametoindex('lo')}"}
    assert identity("socketcan-lo") == "socketcan-lo", "a replugged adapter has another number"


@pytest.mark.parametrize(
    ("device", "said"),
    [
        ("/dev/null", "/dev/null is no pseudo terminal"),
        ("/dev/ttyUSB77", "/dev/ttyUSB77 is not there, so it is not seen to be a pseudo terminal"),
        ("/dev/serial/by-id/none", "is not there"),
        ("tcp 192.0.2.1:502", "192.0.2.1 is not this machine"),
        ("udp no-such-host.invalid:5", "no-such-host.invalid can't be looked up, so it is not seen to be this machine"),
        ("socketcan-lo", "lo is no virtual interface"),
        ("ethercat lo", "lo is not seen to be a veth pair"),
    ],
)
def test_what_may_be_real(device, said):
    assert said in real_because(device)


def test_a_link_is_judged_by_what_it_leads_to(tmp_path):
    (tmp_path / "board").symlink_to("/dev/null")
    assert real_because(str(tmp_path / "board")) == f"{tmp_path / 'board'} (/dev/null) is no pseudo terminal"
    _, terminal = os.openpty()
    (tmp_path / "emulated").symlink_to(os.ttyname(terminal))
    assert real_because(str(tmp_path / "emulated")) is None
    os.close(terminal)


def test_what_is_emulated_or_not_there_yet():
    for device in (
        "tcp localhost:5020",
        "udp 127.0.0.1:5500",
        "/tmp/no-such-board-yet",
        "socketcan-none0",
        "ethercat none0",
        "bench",
    ):
        assert real_because(device) is None


@pytest.mark.parametrize(
    ("kind", "number", "hardware", "real"),
    [
        ("vcan", "280", False, False),
        ("vxcan", "280", False, False),
        ("can", "280", True, True),
        ("slcan", "280", False, True),
        ("", "280", False, True),
        (None, "280", False, False),
        (None, "280", True, True),
        (None, "1", False, True),
    ],
)
def test_a_can_interface_is_judged_by_what_the_kernel_says_of_it(tmp_path, monkeypatch, kind, number, hardware, real):
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "type").write_text(f"{number}\n")
    if hardware:
        (tmp_path / "can0" / "device").mkdir()
    monkeypatch.setattr(device_identity, "_INTERFACES", tmp_path)
    monkeypatch.setattr(device_identity, "kind_of_link", lambda name: kind)
    assert (real_because("socketcan-can0") is not None) == real


def test_the_kernel_is_asked_what_kind_of_interface_it_is(monkeypatch):
    assert device_identity.kind_of_link("lo") == ""
    assert device_identity.kind_of_link("nosuchcan0") is None
    monkeypatch.setattr(socket, "AF_NETLINK", 4711)
    assert device_identity.kind_of_link("lo") is None, "a service may not ask"
