"""The amplifier with commands such as "set,0,12.300", over a serial line."""

import pytest

from .lines import Bench, write_cell

AMPLIFIER = """\
    serial: {{device: {device}, baud: 19200{more}}}
    watchdog: outputs to 0 V
    ascii:
      preset: command,value
      identity: {{request: ver, pattern: "^NV40/3"}}
      read:
        monitor: {{command: rk, rate_hz: 50, fields: {{monitor_x: {{item: "0"}}}}}}
        strains:
          command: mess
          rate_hz: 50
          fields: {{strain_x: {{item: "0"}}, strain_y: {{item: "1", scale: 0.1}}}}
      write:
        voltages:
          command: set
          rate_hz: 50
          cyclic_safe: true
          fields:
            voltage_x: {{item: "0", range: [-20, 150]}}
            voltage_y: {{item: "1", range: [-2, 15], scale: 0.1}}
"""


@pytest.fixture
def make(tmp_path, closing):
    def make(more=""):
        file = write_cell(tmp_path, AMPLIFIER.format(device=tmp_path / "ttyAmp", more=more))
        bench = closing(Bench(file, watchdog_ms=1e9))
        bench.client = bench.open(tmp_path / "ttyAmp")
        return bench

    return make


@pytest.fixture
def bench(make):
    return make()


TRANSCRIPT = [
    (b"ver", b"NV40/3CLE 0042 simulated\r\n"),
    (b"set,0,12.3456", b""),
    (b"set, 1 , -7", b""),
    (b"rk,0", b"rk,0,12.3456\r\n"),
    (b"blah", b"err,1\r\n"),
    (b"set,2,1", b"err,2\r\n"),
    (b"rk,1", b"err,2\r\n"),
    (b"set,0", b"err,2\r\n"),
    (b"set,0,volt", b"err,3\r\n"),
    (b"set,0,nan", b"err,3\r\n"),
    (b"set,0,150.001", b"err,4\r\n"),
    (b"set,1,-20.1", b"err,4\r\n"),
]


def test_transcript(bench):
    for line, answer in TRANSCRIPT:
        bench.client.write(line + b"\r")
        assert bench.client.silence(0.05) == answer, line
    assert bench.cell.voltages() == {"voltage_x": pytest.approx(12.3456), "voltage_y": pytest.approx(-0.7)}


def test_two_wires_with_an_echo(make):
    """RS-485: what is sent comes back, before the answer."""
    bench = make(", rs485: {echo: true}")
    assert bench.client.ask(b"ver", b"\r") == b"ver\rNV40/3CLE 0042 simulated\r\n"
