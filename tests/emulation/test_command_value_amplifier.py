"""The amplifier with commands such as "set,0,12.300": a transcript, and what it gives to the cell."""

from types import SimpleNamespace

import pytest

from micromanip.emulation.line.command_value_amplifier import CommandValueAmplifier
from micromanip.emulation.line.gcs_axis import Affine

TRANSCRIPT = [
    ("ver", "NV40/3CLE 0042 simulated\r\n"),
    ("set,0,12.3456", ""),
    ("set, 1 , -7", ""),
    ("rk,0", "rk,0,12.3456\r\n"),
    ("blah", "err,1\r\n"),
    ("set,2,1", "err,2\r\n"),
    ("rk,1", "err,2\r\n"),
    ("set,0", "err,2\r\n"),
    ("set,0,volt", "err,3\r\n"),
    ("set,0,nan", "err,3\r\n"),
    ("set,0,150.001", "err,4\r\n"),
    ("set,1,-20.1", "err,4\r\n"),
]


def test_transcript():
    given = {}
    behind = SimpleNamespace(has=lambda _: False, write=given.update, voltage_V=given.__getitem__)
    writes = {
        ("set", "0"): (Affine("voltage_x"), (-20.0, 150.0)),
        ("set", "1"): (Affine("voltage_y", scale=0.1), (-20.0, 150.0)),
    }
    line = SimpleNamespace(active=lambda _: False)
    amplifier = CommandValueAmplifier(writes, {("rk", "0"): Affine("monitor_x")}, "ver", behind, line)
    assert [(sent, amplifier.answer(sent)) for sent, _ in TRANSCRIPT] == TRANSCRIPT
    assert given == {"voltage_x": pytest.approx(12.3456), "voltage_y": pytest.approx(-0.7)}
