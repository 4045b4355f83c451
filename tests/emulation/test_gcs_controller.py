"""The piezo controller that speaks GCS 2.0: golden transcripts, over TCP and over a serial line."""

import pytest

from .lines import Bench, free_port, write_cell

GCS = """\
    {port}
    silence_ms: 500
    watchdog: outputs to 0 V
    ascii:
      preset: gcs
      identity: Physik Instrumente.*E-727
      read:
        strains:
          command: POS?
          rate_hz: 100
          fields: {{strain_x: {{item: "1"}}, strain_y: {{item: "2", scale: 0.5, offset: 1.0}}}}
      write:
        voltages:
          command: SVA
          rate_hz: 100
          cyclic_safe: true
          fields:
            voltage_x: {{item: "1", range: [-20, 120]}}
            voltage_y: {{item: "2", range: [-20, 120]}}
"""
IDENTITY = b"(c)2015 Physik Instrumente (PI) GmbH & Co. KG, E-727, 0119000001, 13.21.00.09\n"


@pytest.fixture
def make(tmp_path, closing):
    return lambda port, **options: closing(Bench(write_cell(tmp_path, GCS.format(port=port)), **options))


@pytest.fixture
def bench(make):
    port = free_port()
    bench = make(f"tcp: {{host: 127.0.0.1, port: {port}}}", watchdog_ms=1e9)
    bench.port = port
    bench.client = bench.connect(port)
    return bench


TRANSCRIPT = [
    (b"*IDN?", IDENTITY),
    (b"ERR?", b"0\n"),
    (b"CSV?", b"2.0\n"),
    (b"SAI?", b"1 \n2\n"),
    (b"SAI? ALL", b"1 \n2\n"),
    (b"TPC?", b"2\n"),
    (b"SVA?", b"1=0.000000e+00 \n2=0.000000e+00\n"),
    (b"SVA 1 12.5 2 -7.25", None),
    (b"SVA? 2 1", b"2=-7.250000e+00 \n1=1.250000e+01\n"),
    (b"VOL? 1", b"1=1.250000e+01\n"),
    (b"SVR 1 -0.5", None),
    (b"sva? 1", b"1=1.200000e+01\n"),
    (b"SVO?", b"1=0 \n2=0\n"),
    (b"ONT?", b"1=1 \n2=1\n"),
    (b"VMI? 1", b"1=-2.000000e+01\n"),
    (b"VMA? 1", b"1=1.200000e+02\n"),
    (b"SPA? 1 0x07000601", b"1 0x7000601=UM\n"),
    (b"\x05", b"0\n"),
    (b"\x07", b"\xb1\n"),
    (b"ERR?", b"0\n"),
]


def test_transcript(bench):
    for line, answer in TRANSCRIPT:
        end = b"" if len(line) == 1 else b"\n"
        if answer is None:
            bench.client.write(line + end)
        else:
            assert bench.client.ask(line, end, lines=answer.count(b"\n")) == answer, line


REFUSED = [
    (b"XYZ 1 2", 2),
    (b"MOV 1 5", 5),
    (b"SVA 3 1", 15),
    (b"POS? 1 9", 15),
    (b"SVA 1 121", 17),
    (b"SVA 1 1 2 -21", 17),
    (b"SVO 1 2", 17),
    (b"SVA 1", 24),
    (b"SVA", 24),
    (b"SVA 1 1,5", 25),
    (b"SVA 1 nan", 25),
    (b"SVA 1 inf", 25),
    (b"SPA? 1 0x3C", 54),
    (b"\x18", 10),
]


@pytest.mark.parametrize(("line", "code"), REFUSED)
def test_what_is_wrong_does_nothing_and_is_told_once(bench, line, code):
    bench.client.write(b"SVA 1 3 2 4\n")
    bench.client.write(line if len(line) == 1 else line + b"\n")
    assert bench.client.silence(0.01) == b""
    assert bench.cell.voltages() == {"voltage_x": 3.0, "voltage_y": 4.0}
    assert bench.client.ask(b"ERR?") == b"%d\n" % code
    assert bench.client.ask(b"ERR?") == b"0\n"


def test_lines_may_end_in_any_way_and_come_in_pieces(bench):
    for end in (b"\n", b"\r", b"\r\n"):
        assert bench.client.ask(b"SVA? 1", end) == b"1=0.000000e+00\n"
        assert bench.client.silence(0.005) == b""
    for byte in b"CSV?":
        bench.client.write(bytes([byte]))
    assert bench.client.ask(b"") == b"2.0\n"
    bench.client.write(b"\n \n" + b"x" * 5000 + b"\n")
    assert bench.client.ask(b"ERR?") == b"2\n"
