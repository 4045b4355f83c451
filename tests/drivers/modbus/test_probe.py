"""`micromanip device probe` on a Modbus line: each register under every order, and nothing written."""

import json

import pytest

from micromanip.bus import device_lock
from micromanip.cli.main import main

from .played import played

NEW = ("new", "--driver", "modbus", "--axes", "x", "--probe")


@pytest.fixture
def unit(tmp_path, monkeypatch):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path / "locks")
    with played(tmp_path) as it:
        yield it


def typed(capsys, *arguments):
    try:
        main([*map(str, arguments)])
    except SystemExit as end:
        return end.code, capsys.readouterr()
    return 0, capsys.readouterr()


def test_a_register_under_every_order(unit, capsys):
    unit.order('{"device": "offset", "signal": "strain_x", "value": 12.3456}')
    code, said = typed(capsys, "device", "probe", unit.file, "modbus", "--seconds", "0.1", "--json")
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


def test_what_answers_is_found_without_knowing_it(unit, capsys):
    """Its unit and its registers come with the configuration to begin with; nothing is written."""
    code, said = typed(capsys, *NEW, "--address", f"127.0.0.1:{unit.port}")
    first, *text = said.out.splitlines()
    assert code == 0
    assert first.startswith("# found: unit 1, holding registers: 0-7 ")
    assert any(line.startswith("schema_version: 2") for line in text)
    assert unit.do(unit.devices.report)["outputs"]["voltage_x"]["samples"] == 0


def test_where_nothing_answers_no_configuration_is_made(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(device_lock, "FOLDER", tmp_path / "locks")
    code, said = typed(capsys, *NEW, "--address", "127.0.0.1:1")
    assert (code, said.out) == (69, "")
    assert "127.0.0.1:1 can't be opened: Connection refused" in said.err
