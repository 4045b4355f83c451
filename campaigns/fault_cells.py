"""Cells for the campaign of faults: examples of config/ on ports of their own, and axes held at a slow rate."""

import os
import re
import socket
from string import Template

from .report import CONFIG, CONFIGURATIONS

_DATAGRAMS = socket.SOCK_DGRAM
_LOCK = "lock: {time_constant_ms: 100, within_us: 150}"
"""The deadlines are locked to the first terminal's clock."""


_SOON = (
    ("coast_ms: 1000", "coast_ms: 50"),
    ("max_age_us: 500000", "max_age_us: 100000"),
    ("heartbeat_ms: 1000", "heartbeat_ms: 300"),
    ("silence_ms: 600", "silence_ms: 200"),
)
"""What an example has so that it outlasts a computer that stands still; here a fault is to be noticed soon."""


def example(name, *changes):
    """The example called `name`, not armed; each (pattern, replacement) done once."""
    text = (CONFIG / name).read_text(encoding="utf-8")
    for patient, soon in _SOON:
        text = text.replace(patient, soon)
    for pattern, replacement in ((r"arm_on_start: true ", "arm_on_start: false"), *changes):
        text, count = re.subn(pattern, replacement, text)
        assert count == 1, f"{name}: {pattern} is there {count} times"
    return text


def patient_can_cell():
    """An axis held on a bus of 200 Hz."""
    names = {"name": "cell", "inputs": "Sensors.", "outputs": "Voltages.", "age_us": 200000}
    database = CONFIG / "can" / "manipulator.dbc"
    return assembled("held", "can", database=database, channel=f"patient-{os.getpid()}", **names)


def _ethercat(kind, way):
    names = {"inputs": "", "outputs": "", "age_us": 100000, "interface": f"ec{kind}{os.getpid()}"}
    return assembled("held", "ethercat", way=way, **names)


def assembled(cell, driver, **names):
    """The file `cell` with that of its driver, `names` filled in."""
    return Template(Template(_read(cell)).safe_substitute(driver=_read(driver))).substitute(names)


def _read(name):
    return (CONFIGURATIONS / f"{name}.yaml").read_text(encoding="utf-8")


def free_port(kind=socket.SOCK_STREAM):
    """A port that nobody has just now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


CHANNEL, LINE = f"faults-{os.getpid()}", f"/tmp/micromanip-faults-{os.getpid()}"
CELLS = {
    # GCS over TCP at 100 Hz, and a tracker over UDP
    "gcs": lambda: example(
        "gcs.yaml",
        (r"port: 50000", f"port: {free_port()}"),
        (r"port: 5500, listen: 7001", f"port: {free_port(_DATAGRAMS)}, listen: {free_port(_DATAGRAMS)}"),
    ),
    "modbus": lambda: example("modbus.yaml", (r"port: 5020", f"port: {free_port()}")),
    "line": lambda: example("serial.yaml", (r"/tmp/micromanip-board", LINE)),
    # with a watch over the agreement of the sensors, which a stall among the limits of a simulation would wake too
    "canbus": lambda: example(
        "can.yaml",
        (r"channel: can0\n", f"channel: {CHANNEL}\n"),
        (r"database: can/", f"database: {CONFIG}/can/"),
        (r"(?m)^(    strain: \{coast_ms.*)$", r"\1\n    disagreement: {ratio: 3.0e+4}"),
    ),
    "canopen": lambda: example("canopen.yaml", (r"channel: can0\n", f"channel: {CHANNEL}\n")).replace(
        "eds: can/", f"eds: {CONFIG}/can/"
    ),
    "udp": lambda: example("udp.yaml", (r"port: 4840", f"port: {free_port(_DATAGRAMS)}")),
    "ethercat": lambda: _ethercat("l", _LOCK),
    "ring": lambda: _ethercat("r", f"return_interface: ecr{os.getpid()}b\n    {_LOCK}"),
}
"""By the bus; each on a port of its own."""
