"""The driver `line` fed by programs that know nothing of this project: a plain socket, and socat."""

import contextlib
import json
import shutil
import socket
import struct
import subprocess
import threading
import time
import zlib

import pytest
from micromanip_drivers.line.driver import Line
from micromanip_drivers.line.options import LineOptions

from micromanip.bus.errors import LinkError
from micromanip.bus.inbox import Inbox
from micromanip.settings.text.source import Source

from .lines import ELSEWHERE, free_port, write_cell
from .test_stream_device import CAPACITIVE

pytestmark = pytest.mark.realtime  # so is a foreign program

GAPS_UM = [(round(50.0 + 0.25 * i, 5), round(-3.0 - 0.5 * i, 5)) for i in range(40)]
SIZE = 36
"""Bytes of a datagram."""
needs_socat = pytest.mark.skipif(shutil.which("socat") is None, reason="socat is not installed: apt-get install socat")


def packets(count):
    """A recording of a capacitive sensor: four samples a packet, 1e-5 um a count, the same over and over."""
    recording = bytearray()
    for first in range(0, 4 * count, 4):
        header = bytearray(32)
        header[:4] = b"MEAS"
        struct.pack_into("<i", header, 8, 4711)
        struct.pack_into("<H", header, 24, 4)
        struct.pack_into("<I", header, 28, 1000 + first)
        recording += header
        for x, y in (GAPS_UM * 2)[first % 40 :][:4]:
            recording += struct.pack("<ii", round(x * 1e5), round(y * 1e5))
    return bytes(recording)


def datagram(number, x_mm, y_mm):
    body = b"LT\0\0" + struct.pack(">IQdd", number, 5_000_000 + 1000 * number, x_mm, y_mm)
    return body + struct.pack(">I", zlib.crc32(body))


def driver(folder, text, **ports):
    file = write_cell(folder, text.format(more="", **ports), outputs=ELSEWHERE)
    return Line(LineOptions.model_validate_json(json.dumps(Source.read(file).data["drivers"]["device"])), folder)


def heard(line, within_s=2.0):
    """Pairs of values that the driver takes until its peer has gone silent."""
    pairs, inbox, give_up = [], Inbox(), time.monotonic() + within_s
    with contextlib.suppress(LinkError):
        while time.monotonic() < give_up:
            line.receive(inbox, time.monotonic_ns() + 10_000_000)
            values = [sample.value for sample in inbox]
            pairs += zip(values[::2], values[1::2], strict=True)
            inbox.clear()
    return pairs


@contextlib.contextmanager
def feeding(feed):
    """Call `feed` over and over, in a thread."""
    done = threading.Event()

    def again():
        while not done.is_set():
            feed()

    thread = threading.Thread(target=again)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def assert_from_the_recording(got):
    assert len(got) > 5
    for x, y in got:
        assert (x - 50.0) / 0.25 == pytest.approx((y + 3.0) / -0.5), "both of the same sample"
        assert 49.999 < x < GAPS_UM[-1][0] + 0.001


def test_a_plain_socket(tmp_path):
    port = free_port()
    line = driver(tmp_path, CAPACITIVE, port=port)
    recording = packets(30)
    with socket.create_server(("127.0.0.1", port)) as server:
        server.settimeout(0.1)

        def feed():
            with contextlib.suppress(OSError):
                client, _ = server.accept()
                with client:
                    for i in range(0, len(recording), 7):  # in pieces that know nothing of packets
                        client.sendall(recording[i : i + 7])
                        time.sleep(0.0005)

        with feeding(feed):
            line.open()
            got = heard(line)
            line.close()
    assert_from_the_recording(got)
    assert got[-1] == pytest.approx(GAPS_UM[-1])


@needs_socat
def test_socat_plays_a_recording(tmp_path):
    port = free_port()
    recording = tmp_path / "recording"
    recording.write_bytes(packets(5_000))
    line = driver(tmp_path, CAPACITIVE, port=port)
    listen = f"TCP-LISTEN:{port},bind=127.0.0.1,reuseaddr"
    with subprocess.Popen(["socat", "-u", f"FILE:{recording},ignoreeof", listen]) as socat:
        try:
            for _ in range(50):
                with contextlib.suppress(LinkError):
                    line.open()
                    break
                time.sleep(0.05)
            got = heard(line)
        finally:
            line.close()
            socat.terminate()
    assert got[-1] == pytest.approx(GAPS_UM[-1])
