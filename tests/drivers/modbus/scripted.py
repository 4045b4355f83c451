"""The driver on a port without a wire: a unit of the test's own answers, each answer when and as the test says."""

import time

from micromanip_drivers.modbus.driver import Modbus

from micromanip.bus.inbox import Inbox
from micromanip.emulation.modbus.server import RtuFrames, TcpFrames

from ..line.scripted_port import ScriptedPort

READ = {"value": {"address": 5, "type": "uint16"}}
SERIAL = {"device": "/dev/ttyUSB0", "baud": 115_200}


def options(*, serial, tasks=None, **more):
    port = {"serial": SERIAL} if serial else {"tcp": {"host": "127.0.0.1", "port": 502}}
    tasks = tasks or {"ask": {"function": 3, "rate_hz": 20, "read": READ}}
    unit = {"unit_id": 1, "address_base": 0, "byte_order": "big", "word_order": "big", "tasks": tasks}
    return {**port, "timeout_ms": 15, "response_ms": 1, "drain_ms": 40, "units": {"u": unit}, **more}


class Unit:
    """Answers function 3 with the number of the request, counted from 1, in every register."""

    def __init__(self, serial):
        self.serial, self.requests, self.said = serial, 0, {}
        self.hearing = RtuFrames(5_000_000) if serial else TcpFrames()
        self.heard = []

    def __call__(self, data):
        """What it says to `data`: pairs of a delay (s) and bytes. `said` has its own way with some requests."""
        for request in self.hearing.taken(data, 0):
            self.requests += 1
            self.heard.append(request.pdu)
            frame = request.seal(self.answer(request.pdu))
            yield from self.said.get(self.requests, lambda frame, request: [(0.0, frame)])(frame, request)

    def answer(self, pdu):
        if pdu[0] == 3:
            count = int.from_bytes(pdu[3:5], "big")
            return bytes((3, 2 * count)) + self.requests.to_bytes(2, "big") * count
        return pdu[:5]


class Scripted:
    """The driver, opened; `unit` answers, in its `manner` if it has one. The greeting is request 1."""

    def __init__(self, *, serial, manner=None, **keys):
        self.unit = Unit(serial)
        if manner is not None:
            self.unit.said = dict.fromkeys(range(1, 1000), manner)
        self.driver = Modbus(Modbus.Options.model_validate(options(serial=serial, **keys)), None)
        self.port = ScriptedPort(self.unit)
        self.driver._client._port = self.port
        self.driver.open()
        self.inbox = Inbox()

    def turn(self, values=(), wait_ns=30_000_000, task=0):
        """Do a task, and listen; what came of it."""
        self.inbox.clear()
        self.driver.perform(task, values, self.inbox)
        self.driver.receive(self.inbox, time.monotonic_ns() + wait_ns)
        return [sample.value for sample in self.inbox]
