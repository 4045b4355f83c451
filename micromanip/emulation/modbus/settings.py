"""The device's side of a `modbus` driver: its port, and its units with their registers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from micromanip.emulation.line.device import Behind
from micromanip.emulation.line.port import Hear, LinePort
from micromanip.emulation.line.pseudo_terminal import PseudoTerminal
from micromanip.emulation.line.tcp_port import TcpPort
from micromanip.emulation.plain_options import Place, near, section, value
from micromanip.settings.text.source import Source
from micromanip.testbus.event_loop import EventLoop

from .register import WIDTHS, DeviceRegister
from .unit import COILS, HOLDING, INPUT_REGISTERS, INPUTS, ModbusUnit

_ORDERS = ("byte_order", "word_order")
_READ = {1: COILS, 2: INPUTS, 3: HOLDING, 4: INPUT_REGISTERS, 23: HOLDING}
_WRITTEN = {5: COILS, 6: HOLDING, 15: COILS, 16: HOLDING, 23: HOLDING}


def is_serial(options: Mapping[str, Any]) -> bool:
    """Whether the units are on a serial line."""
    return options.get("serial") is not None


def port_maker(source: Source, place: Place, options: Mapping[str, Any], loop: EventLoop) -> Callable[[Hear], LinePort]:
    """What makes the device's end of the port. Raises ConfigError with file, line and key."""
    if is_serial(options):
        where, keys = (*place, "serial"), options["serial"]
        device, baud = value(source, where, keys, "device", str), value(source, where, keys, "baud", int)
        bits = 10 + (keys.get("parity", "none") != "none") + (keys.get("stopbits", 1) - 1)
        echo = bool((keys.get("rs485") or {}).get("echo"))
        return lambda hear: _pseudo_terminal(loop, Path(device), baud, bits, echo, hear)
    where, keys = (*place, "tcp"), value(source, place, options, "tcp", Mapping)
    host, port = value(source, where, keys, "host", str), value(source, where, keys, "port", int)
    bits_per_s = 1e6 * float(keys.get("link_Mbit_per_s", 100.0))
    return lambda hear: TcpPort(loop, host, port, hear, bits_per_s)


def _pseudo_terminal(loop: EventLoop, device: Path, baud: int, bits_per_byte: int, echo: bool, hear: Hear) -> LinePort:
    def received(data: bytes) -> None:
        hear(data, port)

    port = PseudoTerminal(loop, device, baud, received, bits_per_byte=bits_per_byte, half_duplex=True)
    port.echo = echo
    return port


def read_units(source: Source, place: Place, options: Mapping[str, Any], behind: Behind) -> dict[int, ModbusUnit]:
    """The units by their number on the line. Raises ConfigError with file, line and key."""
    units = {}
    for name, keys in section(source, place, options, "units").items():
        where = (*place, "units", name)
        units[value(source, where, keys, "unit_id", int)] = _unit(source, where, name, keys, behind)
    return units


def slowest_write_ms(source: Source, place: Place, options: Mapping[str, Any]) -> float:
    """Longest period of a task that writes; 0 without one."""
    periods_ms = [0.0]
    for name, keys in section(source, place, options, "units").items():
        for task, entry in section(source, (*place, "units", name), keys, "tasks").items():
            if entry.get("write"):
                where = (*place, "units", name, "tasks", task)
                periods_ms.append(1e3 / float(value(source, where, entry, "rate_hz", (int, float))))
    return max(periods_ms)


def _unit(source: Source, place: Place, name: str, keys: Any, behind: Behind) -> ModbusUnit:
    unit = ModbusUnit(name, behind)
    for task, entry in section(source, place, keys, "tasks").items():
        where = (*place, "tasks", task)
        function = value(source, where, entry, "function", int)
        for table, key in ((_READ.get(function), "read"), (_WRITTEN.get(function), "write")):
            registers = section(source, where, entry, key)
            if registers and table is None:
                raise source.error((*where, "function"), f"function {function} does not {key} registers")
            for register in _registers(source, (*where, key), keys, registers):
                add = unit.add_measured if key == "read" else unit.add_output
                add(str(table), register, f"{name}.{register.name}")
        own = {key: entry[key] for key in ("status", "counter") if entry.get(key)}
        for register in _registers(source, where, keys, own):
            if register.name == "counter":
                unit.add_counter(_READ[function], register)
            else:
                unit.add_constant(_READ[function], register, int((own["status"].get("good") or (0,))[0]))
    identity = section(source, place, keys, "identity")
    for register in _registers(source, (*place, "identity"), keys, identity):
        entry = identity[register.name]
        where = (*place, "identity", register.name)
        function, code = (value(source, where, entry, key, int) for key in ("function", "value"))
        unit.add_constant(_READ[function], register, code)
    return unit


def _registers(source: Source, place: Place, unit: Any, entries: Mapping[str, Any]) -> Iterator[DeviceRegister]:
    base = value(source, place[:4], unit, "address_base", int)
    big_bytes, big_words = (value(source, place[:4], unit, key, str) == "big" for key in _ORDERS)
    for name, entry in entries.items():
        where = (*place, name)
        kind = value(source, where, entry, "type", str)
        if kind not in WIDTHS:
            raise source.error((*where, "type"), f"there is no type {kind}; {near(kind, WIDTHS)}")
        yield DeviceRegister(
            name,
            value(source, where, entry, "address", int) - base,
            kind,
            big_bytes,
            big_words,
            scale=float(entry.get("scale", 1.0)),
            offset=float(entry.get("offset", 0.0)),
            first_bit=int(entry.get("first_bit") or 0),
            bit_count=int(entry.get("bit_count", 1)),
        )
