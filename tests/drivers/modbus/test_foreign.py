"""Foreign programs agree: the library's server with our driver, the library's client and mbpoll with our units."""

import asyncio
import threading

import pytest
from micromanip_drivers.modbus.driver import Modbus
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from micromanip.bus.errors import LinkError
from micromanip.bus.inbox import Inbox

from ..line.wires import free_port, socket
from .played import keys_of, played, until
from .scripted import options

pytestmark = pytest.mark.live  # servers and clients that answer in time


class LibraryServer:
    """Coils 0 to 63 off, inputs on, holding registers that say their address, input registers all 7."""

    def __init__(self):
        self.port = free_port(socket.SOCK_STREAM)
        self.loop = asyncio.new_event_loop()
        self.server = None
        self.thread = threading.Thread(target=self.loop.run_until_complete, args=(self.serve(),))
        self.thread.start()
        until(lambda: self.server is not None)

    async def serve(self):
        bits, registers = DataType.BITS, DataType.REGISTERS
        unit = SimDevice(
            1,
            simdata=(
                [SimData(0, values=[False] * 64, datatype=bits)],
                [SimData(0, values=[True] * 64, datatype=bits)],
                [SimData(0, values=list(range(200)), datatype=registers)],
                [SimData(0, values=[7] * 200, datatype=registers)],
            ),
        )
        server = ModbusTcpServer(unit, address=("127.0.0.1", self.port))
        await server.serve_forever(background=True)
        self.ended = asyncio.Event()
        self.server = server
        await self.ended.wait()
        await server.shutdown()

    def close(self):
        self.loop.call_soon_threadsafe(self.ended.set)
        self.thread.join()
        self.loop.close()


@pytest.fixture
def library():
    server = LibraryServer()
    yield server
    server.close()


def test_the_librarys_server_understands_every_function(library):
    word = {"type": "uint16", "cyclic_safe": True}
    coil = {"type": "coil", "cyclic_safe": True}
    tasks = {
        "five": {"function": 5, "rate_hz": 1, "write": {"c0": {"address": 3, **coil}}},
        "fifteen": {
            "function": 15,
            "rate_hz": 1,
            "write": {"c1": {"address": 8, **coil}, "c2": {"address": 9, **coil}},
        },
        "six": {"function": 6, "rate_hz": 1, "write": {"w0": {"address": 100, **word}}},
        "sixteen": {"function": 16, "rate_hz": 1, "write": {"w1": {"address": 101, **word}}},
        "both": {
            "function": 23,
            "rate_hz": 1,
            "write": {"w2": {"address": 102, "type": "int32", "cyclic_safe": True}},
            "read": {"r": {"address": 40, "type": "int32"}},
        },
        "one": {"function": 1, "rate_hz": 1, "read": {f"b{i}": {"address": i, "type": "coil"} for i in (3, 8, 9)}},
        "two": {"function": 2, "rate_hz": 1, "read": {"i": {"address": 5, "type": "coil"}}},
        "three": {"function": 3, "rate_hz": 1, "read": {"h": {"address": 100, "type": "int64"}}},
        "four": {"function": 4, "rate_hz": 1, "read": {"n": {"address": 9, "type": "uint16"}}},
    }
    keys = options(serial=False, tasks=tasks, tcp={"host": "127.0.0.1", "port": library.port})
    driver = Modbus(Modbus.Options.model_validate({**keys, "timeout_ms": 90}), None)
    wanted = {"c0": 1.0, "c1": 0.0, "c2": 1.0, "w0": 0x1234, "w1": 0x5678, "w2": -2.0}
    inbox = Inbox()
    until(lambda: opened(driver))
    try:
        for task in range(len(driver.tasks)):
            driver.perform(task, list(wanted.values()), inbox)
        driver._finish(inbox)
    finally:
        driver.close()
    found = {driver.inputs[sample.channel].name.removeprefix("u."): sample.value for sample in inbox}
    assert [channel.name.removeprefix("u.") for channel in driver.outputs] == list(wanted)
    assert found == {
        "r": 40 * 0x10000 + 41,
        "b3": 1.0,
        "b8": 0.0,
        "b9": 1.0,
        "i": 1.0,
        "h": float(0x1234_5678_FFFF_FFFE),
        "n": 7.0,
    }


def opened(driver):
    try:
        driver.open()
    except LinkError:  # it does not listen yet
        return False
    return True


@pytest.mark.parametrize("name", ["modbus.yaml", "modbus_rtu.yaml"], ids=["tcp", "rtu"])
def test_the_librarys_client_understands_our_units(tmp_path, name):
    with played(tmp_path, name) as unit:
        if "tcp" in keys_of(unit.config):
            client, lines = ModbusTcpClient("127.0.0.1", port=unit.port, timeout=2), 18
        else:
            client, lines = ModbusSerialClient(unit.path, baudrate=115_200, timeout=2), 9
        with client:
            assert not client.write_registers(100, [0, 8000, 0, 1], device_id=1).isError()
            assert client.read_holding_registers(100, count=4, device_id=1).registers == [0, 8000, 0, 1]
            assert client.read_holding_registers(lines, count=1, device_id=1).registers == [0xFF]
            both = client.readwrite_registers(
                read_address=0, read_count=2, write_address=100, values=[0] * 4, device_id=1
            )
            assert not both.isError()
            assert client.read_holding_registers(60, count=1, device_id=1).exception_code == 2
            assert client.write_register(0, 1, device_id=1).exception_code == 2
            assert client.read_exception_status(device_id=1).exception_code == 1
    assert unit.devices.cell.report()["outputs"]["voltage_y"]["max"] == 40.0
