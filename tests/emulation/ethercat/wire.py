"""A veth pair of this test's own, and what plays the slaves at its far end."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PATIENCE_S = 10.0


@contextlib.contextmanager
def veth(name):
    """The names of both ends; skips where this process may not make them."""
    here, there = f"{name}{os.getpid() % 100000}a", f"{name}{os.getpid() % 100000}b"
    try:
        made = subprocess.run(
            ["ip", "link", "add", here, "type", "veth", "peer", "name", there], capture_output=True, text=True
        )
    except FileNotFoundError:
        pytest.skip("needs the command ip")
    if made.returncode:
        pytest.skip(f"needs rights to make a veth pair (root, CAP_NET_ADMIN): {made.stderr.strip()}")
    try:
        for end in (here, there):
            Path(f"/proc/sys/net/ipv6/conf/{end}/disable_ipv6").write_text("1")
            subprocess.run(["ip", "link", "set", end, "up"], check=True)
        yield here, there
    finally:
        subprocess.run(["ip", "link", "del", here], check=True)


@contextlib.contextmanager
def slaves(interface, line="cell"):
    """A line of `play.py` in a process of its own: some masters hold Python's lock while they wait."""
    command = [sys.executable, "-m", "tests.emulation.ethercat.play", interface, line]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "up\n"
            yield process
        finally:
            process.terminate()


def until(true):
    """Wait until `true()` says so; what it said last."""
    end = time.monotonic() + PATIENCE_S
    while not (said := true()) and time.monotonic() < end:
        time.sleep(0.001)
    return said


def raw(interface):
    """A socket for EtherCAT frames."""
    opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x88A4))
    opened.bind((interface, 0x88A4))
    return opened
