"""The device of a driver `line`, as its port and its framing say: a board, a controller, an amplifier, a sensor."""

from __future__ import annotations

from micromanip.emulation.emulated import EmulatedDevice, Surroundings

from .binary_board import BinaryBoard
from .device import Behind
from .device_line import DeviceLine, port_maker
from .gcs_controller import GcsController
from .stream_device import StreamDevice


def emulate_line(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Line and device of the driver called `name`."""
    keys, loop = surroundings.options(name), surroundings.loop
    if keys.ascii is not None and keys.ascii.preset != "gcs":
        where = ("drivers", name, "ascii", "preset")
        raise surroundings.source.error(where, "devices that speak lines of text are emulated for the preset gcs only")
    wires = surroundings.wires(name)
    writes = keys.binary.send if keys.binary else keys.ascii.write if keys.ascii else {}
    amplifier = surroundings.amplifier(wires, (message.rate_hz for message in writes.values()))
    behind = Behind(surroundings.cell, wires, amplifier)
    line = DeviceLine(loop, port_maker(keys, loop))
    if keys.binary is not None:
        return BinaryBoard(loop, line, behind, keys.binary)
    if keys.ascii is not None:
        return GcsController(loop, line, behind, keys.ascii)
    return StreamDevice(loop, line, behind, name, keys.stream)
