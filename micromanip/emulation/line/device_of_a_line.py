"""The device of a driver `line`, as its port and its framing say: a board, a controller, an amplifier, a sensor."""

from __future__ import annotations

from typing import Any

from micromanip.emulation.emulated import EmulatedDevice, Surroundings
from micromanip.testbus.event_loop import EventLoop

from .ascii_device import PRESETS, AsciiDevice
from .binary_board import BinaryBoard, board_messages
from .device import Behind, LineDevice
from .device_line import DeviceLine, port_maker
from .stream_device import StreamDevice, packet_layout, samples_per_packet


def emulate_line(name: str, surroundings: Surroundings) -> EmulatedDevice:
    """Line and device of the driver called `name`."""
    keys, loop = surroundings.options(name), surroundings.loop
    if keys.ascii is not None and keys.ascii.preset not in PRESETS:
        where = ("drivers", name, "ascii", "preset")
        raise surroundings.source.error(where, f"devices are emulated for the presets {' and '.join(PRESETS)}")
    wires = surroundings.wires(name)
    amplifier = surroundings.amplifier(wires, _slowest_write_ms(keys) if wires.outputs else 0.0)
    behind = Behind(surroundings.cell, wires, amplifier)
    line = DeviceLine(loop, port_maker(keys, loop))
    return _device(name, keys, loop, line, behind)


def _device(name: str, keys: Any, loop: EventLoop, line: DeviceLine, behind: Behind) -> LineDevice:
    if keys.binary is not None:
        return BinaryBoard(loop, line, behind, board_messages(keys.binary))
    if keys.ascii is not None:
        interpreter = PRESETS[keys.ascii.preset](keys.ascii, behind, line)
        return AsciiDevice(loop, line, behind, interpreter, round(keys.ascii.turnaround_us * 1e3))
    stream = keys.stream
    period_ns, samples = round(1e9 / stream.rate_hz), samples_per_packet(stream)
    begin = bytes.fromhex(stream.start)
    return StreamDevice(loop, line, behind, name, packet_layout(stream), period_ns, samples, begin)


def _slowest_write_ms(keys: Any) -> float:
    """Longest period of what is written."""
    writes = keys.binary.send if keys.binary else keys.ascii.write if keys.ascii else {}
    return max((1e3 / message.rate_hz for message in writes.values()), default=0.0)
