"""The board that speaks in binary frames, at the other end of a serial line."""

import struct

import pytest

from .lines import Bench, write_cell

BOARD = """\
    serial: {{device: {device}, baud: 4000000}}
    silence_ms: 200
    watchdog: outputs to 0 V
    binary:
      sync: aa 55
      length: {{at: 2, type: uint8, plus: 5}}
      kind: {{at: 3, type: uint8}}
      crc: {{name: crc8.smbus, first: 2}}
      identity:
        request: aa 55 00 01
        kind: 0x81
        numbers: {{serial_number: {{at: 4, type: uint32, byte_order: little, value: 1234}}}}
      receive:
        strains:
          kind: 0x10
          rate_hz: 2000
          counter: {{at: 4, type: uint16, byte_order: little}}
          status: {{at: 6, type: uint8, good: [0]}}
          fields:
            strain_x: {{at: 7, type: int32, byte_order: little, scale: 1.0e-4}}
            strain_y: {{at: 11, type: int32, byte_order: big, scale: 1.0e-4, offset: -2.5}}
        monitor:
          kind: 0x11
          rate_hz: 100
          fields: {{true_strain_x: {{at: 4, type: float32, byte_order: big}}}}
      send:
        voltages:
          kind: 0x20
          rate_hz: 2000
          cyclic_safe: true
          counter: {{at: 4, type: uint16, byte_order: little}}
          fields:
            voltage_x: {{at: 6, type: int16, byte_order: little, scale: 0.005, range: [-20, 150]}}
            voltage_y: {{at: 8, type: int16, byte_order: little, scale: 0.005, range: [-20, 150]}}
        ask: {{kind: 0x30, rate_hz: 100, reply: monitor}}
"""


STRAINS = 0x10


def crc8(data):
    """CRC-8/SMBUS, bit by bit: polynomial 0x07, begins with 0."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ 0x107 if crc & 0x80 else crc << 1
    return crc


def frame(kind, payload=b""):
    body = bytes([len(payload), kind]) + payload
    return b"\xaa\x55" + body + bytes([crc8(body)])


def voltages(x, y, count=0):
    return frame(0x20, struct.pack("<Hhh", count, round(x / 0.005), round(y / 0.005)))


@pytest.fixture
def bench(tmp_path, closing):
    bench = closing(Bench(write_cell(tmp_path, BOARD.format(device=tmp_path / "ttyBoard"))))
    bench.client = bench.open(tmp_path / "ttyBoard")
    bench.client.silence(0.001)
    return bench


def frames(data, kind=STRAINS):
    """Payloads of the whole and good frames in what was read."""
    found = []
    while (start := data.find(b"\xaa\x55")) >= 0:
        data = data[start:]
        length = data[2] if len(data) > 2 else 0
        whole = data[: length + 5]
        if len(whole) == length + 5 and crc8(whole[2:-1]) == whole[-1]:
            if whole[3] == kind:
                found.append(whole[4:-1])
            data = data[length + 5 :]
        else:
            data = data[1:]
    return found


def counts(data):
    return [payload[0] | payload[1] << 8 for payload in frames(data)]


def command_for(bench, seconds, **volts):
    for i in range(round(seconds * 500)):
        bench.client.write(voltages(volts.get("x", 0.0), volts.get("y", 0.0), i))
        bench.run(0.001)


def test_a_frame_in_pieces_between_noise_arrives_and_a_damaged_one_does_not(bench):
    whole = voltages(30.0, 10.0)
    for i in range(len(whole)):
        bench.client.write(whole[i : i + 1])
    assert bench.cell.voltages()["voltage_x"] == pytest.approx(30.0)
    bench.client.write(b"\xaa\xaa\x55\xff" + voltages(31.0, 10.0) + b"noise")
    assert bench.cell.voltages()["voltage_x"] == pytest.approx(31.0)
    damaged = bytearray(voltages(99.0, 10.0))
    damaged[7] ^= 0x10
    bench.client.write(bytes(damaged))
    bench.client.write(b"\xaa\x55\x02\x20\x00\x00" + bytes([crc8(b"\x02\x20\x00\x00")]))
    bench.client.write(voltages(32.0, 10.0))
    assert bench.cell.voltages()["voltage_x"] == pytest.approx(32.0)
    assert bench.figures()["not_understood"] >= 1
    assert bench.devices.report()["outputs"]["voltage_x"]["max"] < 99.0


def test_counter_stands_still_and_messages_are_silent_on_command(bench):
    bench.order(device="stop_counter", for_s=0.01)
    bench.client.silence(0.001)
    numbers = counts(bench.client.silence(0.008))
    assert len(set(numbers)) == 1
    assert len(numbers) > 12
    bench.run(0.002)
    bench.order(device="silence", for_s=0.01)
    bench.client.silence(0.001)
    assert counts(bench.client.silence(0.007)) == []
    assert len(counts(bench.client.silence(0.02))) > 20


def test_reboot(bench):
    command_for(bench, 0.05, x=60.0)
    bench.order(device="reboot", for_s=0.3)
    bench.client.silence(0.001)
    bench.client.write(voltages(50.0, 0.0))
    assert bench.client.silence(0.25) == b""
    assert bench.cell.voltages()["voltage_x"] == pytest.approx(0.0)
    assert counts(bench.client.silence(0.06))[0] == 0
