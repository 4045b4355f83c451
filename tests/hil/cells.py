"""The examples of config/ for a campaign: on ports and channels of their own, ready and not armed."""

import os
import re
import socket
from pathlib import Path

CONFIG = Path(__file__).parents[2] / "config"


def changed(name, *changes):
    """The example called `name`, each (pattern, replacement) done once."""
    text = (CONFIG / name).read_text(encoding="utf-8")
    for pattern, replacement in ((r"arm_on_start: true ", "arm_on_start: false"), *changes):
        text, count = re.subn(pattern, replacement, text)
        assert count == 1, f"{name}: {pattern} is there {count} times"
    return text


def can_cell(*changes):
    """CAN FD at 2 kHz."""
    channel = (r"channel: can0\n", f"channel: faults-{os.getpid()}\n")
    return changed("can.yaml", channel, (r"database: can/", f"database: {CONFIG}/can/"), *changes)


def watched_can_cell():
    """The same with a watch over the agreement of the sensors.

    It is off among the limits of a simulation: a stall of the machine would be taken for it too.
    """
    return can_cell((r"(?m)^(    strain: \{coast_ms.*)$", r"\1\n    disagreement: {ratio: 3.0e+4}"))


def modbus_cell():
    """Modbus TCP at 500 Hz."""
    return changed("modbus.yaml", (r"port: 5020", f"port: {free_port()}"))


def serial_cell():
    """A board on a line at 2 kHz."""
    return changed("serial.yaml", (r"/tmp/micromanip-board", f"/tmp/micromanip-faults-{os.getpid()}"))


def gcs_cell():
    """A GCS controller over TCP at 100 Hz, a tracker over UDP."""
    return changed(
        "gcs.yaml",
        (r"port: 50000", f"port: {free_port()}"),
        (r"port: 5500, listen: 7001", f"port: {free_port(socket.SOCK_DGRAM)}, listen: {free_port(socket.SOCK_DGRAM)}"),
    )


def free_port(kind=socket.SOCK_STREAM):
    """A port that nobody has just now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
