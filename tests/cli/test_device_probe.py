"""``micromanip device probe``: what answers on a bus, and a clear word where it can't be looked at."""

import re
from functools import partial

import pytest
from conformance.example import UdpPeer, UdpStage

from micromanip.bus import device_lock
from micromanip.bus.device_lock import DeviceLocks
from micromanip.bus.driver import Answer, BusDriver

from .command import code_of


class Stage(UdpStage):
    """The driver of the example; a test may take its probe."""

    probed = None

    def probe(self, seconds):
        return self.probed(seconds) if self.probed else super().probe(seconds)


class Blind(UdpStage):
    """It has no probe."""

    probe = BusDriver.probe


@pytest.fixture
def config(tmp_path, announce, monkeypatch):
    """A configuration, with a peer that is not started; what else is in the file does not matter."""
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path / "locks")
    announce("stage", f"{__name__}:Stage")
    announce("blind", f"{__name__}:Blind")
    peer = UdpPeer()
    file = tmp_path / "cell.yaml"
    file.write_text(
        "axes: 5\ndrivers:\n"
        f"  stage: {{driver: stage, port: {peer.port}, serial_number: 7}}\n"
        f"  blind: {{driver: blind, port: {peer.port}, serial_number: 7}}\n"
        "  cell: {driver: simulated}\n  wrong: {driver: stage, port: 70000, serial_number: 7}\n"
        "  none: {driver: stagge}\n"
    )
    return file, peer


ended = partial(code_of, "device", "probe")


def test_answers_in_a_table(config, capsys):
    file, peer = config
    peer.start()
    try:
        assert ended(file, "stage", "--seconds", "0.2") == 0
        assert not peer.writes(), "nothing is moved"
    finally:
        peer.kill()
    rows = [
        re.split(r"\s*[│┃]\s*", line)[1:-1] for line in capsys.readouterr().out.splitlines() if re.match("[│┃]", line)
    ]
    assert rows[:4] == [
        ["answers", "name", "value", "note"],
        [f"udp 127.0.0.1:{peer.port}", "serial_number", "7", ""],
        ["strains in um", "strain_x", "0", ""],
        ["", "strain_y", "0", ""],
    ]


def test_no_device_is_69(config, capsys):
    assert ended(config[0], "stage", "--seconds", "0.1") == 69
    line = capsys.readouterr().err.strip()
    device = f"udp 127.0.0.1:{config[1].port}"
    assert line.startswith(f"micromanip: {device} ")
    assert line.count(device) == 1
    assert "\n" not in line


def test_refusals_alone_are_69_and_shown(config, monkeypatch, capsys):
    """An exception is an answer, but no value."""
    answers = [Answer("cell.strain_x", {}, "exception 2", is_value=False), Answer("b", {}, "silent", is_value=False)]
    monkeypatch.setattr(Stage, "probed", lambda self, seconds: iter(answers))
    assert ended(config[0], "stage", "--seconds", "0.1") == 69
    out, err = capsys.readouterr()
    assert "exception 2" in out
    assert "silent" in out
    assert "cell.strain_x: exception 2 (and 1 more)" in err


def test_device_in_use_is_refused(config, monkeypatch, capsys):
    monkeypatch.setattr(Stage, "probed", lambda self, seconds: pytest.fail("it looked all the same"))
    with DeviceLocks([f"udp 127.0.0.1:{config[1].port}"]):
        assert ended(config[0], "stage") == 69
    assert f"udp 127.0.0.1:{config[1].port}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("driver", "code", "message"),
    [
        ("blind", 64, "driver blind has no probe"),
        ("stag", 64, "did you mean stage?"),
        ("wrong", 78, "cell.yaml:6: drivers.wrong.port: "),
        ("none", 78, "cell.yaml:7: drivers.none.driver: no driver called stagge is installed; did you mean stage?"),
    ],
)
def test_what_cannot_be_looked_at(driver, code, message, config, capsys):
    assert ended(config[0], driver) == code
    shown = capsys.readouterr().err
    assert message in shown
    assert len(shown.strip().splitlines()) == 1
