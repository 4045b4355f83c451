"""`micromanip device probe` on a Modbus line: each register under every order, and nothing written."""

import json

import pytest

from micromanip.bus import device_lock
from micromanip.cli.main import main

from .played import played


@pytest.fixture
def unit(tmp_path, monkeypatch):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path / "locks")
    with played(tmp_path) as it:
        yield it


def probed(capsys, *arguments):
    try:
        main(["device", "probe", *map(str, arguments)])
    except SystemExit as end:
        return end.code, capsys.readouterr()
    return 0, capsys.readouterr()


def test_a_register_under_every_order(unit, capsys):
    unit.order('{"device": "offset", "signal": "strain_x", "value": 12.3456}')
    code, said = probed(capsys, unit.file, "modbus", "--seconds", "0.1", "--json")
    assert code == 0
    answers = {answer["name"]: answer for answer in json.loads(said.out)["answers"]}
    strain = answers["cell.strain_x"]
    wire = bytes.fromhex(strain["values"]["on the wire"])
    assert len(wire) == 4
    assert strain["note"] == "configured: bytes big, words big"
    for name, order in {
        "bytes big, words big": (0, 1, 2, 3),
        "bytes little, words big": (1, 0, 3, 2),
        "bytes big, words little": (2, 3, 0, 1),
        "bytes little, words little": (3, 2, 1, 0),
    }.items():
        number = int.from_bytes(bytes(wire[place] for place in order), "big", signed=True)
        assert strain["values"][name] == pytest.approx(1e-4 * number)
    assert set(answers["cell.voltage_x"]["values"]) == {"address", "type", "on the wire", "bytes big", "bytes little"}
    assert "exchange, status" in " ".join(answers)
    assert unit.do(unit.devices.report)["outputs"]["voltage_x"]["samples"] == 0
