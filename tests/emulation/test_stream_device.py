"""Sensors that send packets by themselves: a capacitive one over TCP, a laser tracker over UDP."""

import contextlib
import socket
import struct
import zlib

import numpy as np
import pytest

from .lines import ELSEWHERE, Bench, free_port, write_cell

CAPACITIVE = """\
    tcp: {{host: 127.0.0.1, port: {port}}}
    silence_ms: 100
    stream:
      magic: 4d 45 41 53
      header_bytes: 32
      identity: {{serial_number: {{at: 8, type: int32, byte_order: little, value: 4711}}}}
      status: {{at: 20, type: uint32, byte_order: little, good: [0]}}
      blocks: {{at: 24, type: uint16, byte_order: little, most: 8}}
      counter: {{at: 28, type: uint32, byte_order: little, counts: samples}}
      rate_hz: 4000
      block_bytes: 8
      fields:
        strain_x: {{at: 0, type: int32, byte_order: little, scale: 1.0e-5}}
        strain_y: {{at: 4, type: int32, byte_order: little, scale: 1.0e-5}}
"""
TRACKER = """\
    udp: {{host: 127.0.0.1, port: {port}, listen: {listen}}}
    silence_ms: 100
    stream:
      magic: 4c 54
      header_bytes: 16
      counter: {{at: 4, type: uint32, byte_order: big, counts: packets}}
      time: {{at: 8, type: uint64, byte_order: big, unit_s: 1.0e-6}}
      rate_hz: 1000
      block_bytes: 16
      crc: {{name: crc32.iso_hdlc, byte_order: big}}
{more}
      fields:
        strain_x: {{at: 0, type: float64, byte_order: big, scale: 1000.0}}
        strain_y: {{at: 8, type: float64, byte_order: big, scale: 1000.0}}
"""
HEADER = struct.Struct("<4s4xi4x4xI H2x I")


def packets(data):
    """Header (without magic) and samples of each whole packet."""
    found = []
    while len(data) >= 32:
        magic, serial_number, status, blocks, counter = HEADER.unpack_from(data)
        assert magic == b"MEAS"
        end = 32 + 8 * blocks
        if len(data) < end:
            break
        found.append(((serial_number, status, blocks, counter), np.frombuffer(data[32:end], "<i4").reshape(-1, 2)))
        data = data[end:]
    return found


@pytest.fixture
def capacitive(tmp_path, closing):
    port = free_port()
    bench = closing(Bench(write_cell(tmp_path, CAPACITIVE.format(port=port), outputs=ELSEWHERE)))
    bench.port = port
    return bench


@pytest.fixture
def tracker(tmp_path):
    with contextlib.ExitStack() as stack:

        def make(more="", *, listens=True):
            receiver = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            receiver.bind(("127.0.0.1", 0))
            receiver.setblocking(False)
            port, listen = free_port(socket.SOCK_DGRAM), receiver.getsockname()[1] if listens else "null"
            driver = TRACKER.format(port=port, listen=listen, more=more)
            bench = Bench(write_cell(tmp_path, driver, outputs=ELSEWHERE))
            stack.callback(bench.close)
            bench.port, bench.receiver = port, receiver
            return bench

        yield make


def datagrams(bench):
    """All that wait: pairs of content and port of the sender."""
    got = []
    with contextlib.suppress(BlockingIOError):
        while True:
            data, address = bench.receiver.recvfrom(2048)
            got.append((data, address[1]))
    return got


def test_packets_have_header_counter_and_blocks(capacitive):
    client = capacitive.connect(capacitive.port)
    client.read()
    capacitive.run(0.1)
    found = packets(client.read())
    assert len(found) == pytest.approx(100, abs=1), "a thousand packets a second, of four samples each"
    assert {header[:3] for header, _ in found} == {(4711, 0, 4)}
    assert set(np.diff([header[3] for header, _ in found])) == {4}
    newest = found[-1][1][-1] * 1e-5
    plant = capacitive.cell.plant
    assert newest == pytest.approx([plant.value("strain_x"), plant.value("strain_y")], abs=1e-3)


def test_a_reader_that_stands_still_loses_whole_packets(capacitive):
    client = capacitive.connect(capacitive.port, receive_buffer=8192)
    capacitive.run(8.0)
    late = packets(client.read() + client.silence(0.1))
    steps = np.diff([header[3] for header, _ in late])
    assert (steps[:-1] == 4).sum() > 20
    assert steps.max() > 1000, "what it did not read in time is not queued for ever"
    assert capacitive.figures()["bytes_lost"] > 100_000


def test_datagrams_have_counter_time_and_checksum(tracker):
    bench = tracker()
    bench.run(0.05)
    got = datagrams(bench)
    assert {port for _, port in got} == {bench.port}
    times, counters = [], []
    for data, _ in got:
        assert len(data) == 16 + 16 + 4
        assert data[:2] == b"LT"
        assert struct.unpack(">I", data[-4:])[0] == zlib.crc32(data[:-4])
        counters.append(struct.unpack_from(">I", data, 4)[0])
        times.append(struct.unpack_from(">Q", data, 8)[0])
    assert counters == list(range(50))
    assert set(np.diff(times)) <= {1000, 1001}
    assert times[0] > 1e9, "its clock is its own"
    x, y = struct.unpack_from(">dd", got[-1][0], 16)
    plant = bench.cell.plant
    assert (1000 * x, 1000 * y) == (plant.value("strain_x"), plant.value("strain_y"))


def test_it_answers_to_where_it_was_asked(tracker):
    bench = tracker('      start: "01 02"', listens=False)
    bench.run(0.01)
    assert datagrams(bench) == []
    bench.receiver.sendto(b"\x01\x02", ("127.0.0.1", bench.port))
    bench.until(lambda: datagrams(bench))
