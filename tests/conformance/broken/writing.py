"""Drivers that write wrongly."""

import math
import struct
import time

from conformance.example import UdpPeer, UdpStage, WatchedDevice, wire
from micromanip.bus.driver import Outcome
from micromanip.bus.errors import OutputRefused

from . import broken


@broken("test_golden_outputs")
class CrossedAxes(UdpStage):
    def perform(self, task, values, inbox):
        super().perform(task, values[::-1], inbox)


@broken("test_what_is_written_arrives")
class SendsOnce(UdpStage):
    sent = False

    def perform(self, task, values, inbox):
        if not self.sent:
            super().perform(task, values, inbox)
            self.sent = all(math.isfinite(value) for value in values)


@broken("test_what_is_said_of_a_write_is_true")
class SaysHeld(UdpStage):
    def perform(self, task, values, inbox):
        super().perform(task, values, inbox)
        return Outcome.HELD


@broken("test_what_is_read_back_is_what_was_written")
class MovesToReadBack(UdpStage):
    def read_outputs(self):
        self.perform(0, [0.0, 0.0], None)
        time.sleep(0.05)
        return [None, None]


@broken("test_value_that_is_no_number_is_refused")
class NoNumberIsZero(UdpStage):
    def perform(self, task, values, inbox):
        super().perform(task, [value if math.isfinite(value) else 0.0 for value in values], inbox)


@broken("test_value_beyond_the_wire_is_refused")
class Saturates(UdpStage):
    def perform(self, task, values, inbox):
        super().perform(task, [min(max(value, -163.84), 163.835) for value in values], inbox)


@broken("test_value_beyond_the_wire_is_refused")
class RefusesTooLate(UdpStage):
    def perform(self, task, values, inbox):
        try:
            super().perform(task, values, inbox)
        except OutputRefused:
            if all(math.isfinite(value) for value in values):
                super().perform(task, [0.0, 0.0], inbox)
            raise


@broken("test_latest_value_wins")
class Queues(UdpStage):
    def __init__(self, options, folder):
        super().__init__(options, folder)
        self.queue = []

    def perform(self, task, values, inbox):
        silent = self.heard_ns and time.monotonic_ns() - self.heard_ns > 10_000_000
        real, self.send = self.send, self.queue.append
        try:
            super().perform(task, values, inbox)
        finally:
            self.send = real
        while self.queue and not silent:
            self.send(self.queue.pop(0))


class HalvesDevice(WatchedDevice):
    def __init__(self, port):
        super().__init__(port)
        self.halves = bytearray(4)
        self.told = None

    def answer(self, datagram, sender):
        if datagram[:1] == b"B":
            self.halves[datagram[1]] = datagram[2]
        super().answer(datagram, sender)

    def state(self):
        x, y = struct.unpack(">hh", self.halves)
        return {"voltage_x": x * wire.V_PER_STEP, "voltage_y": y * wire.V_PER_STEP}


class HalvesPeer(UdpPeer):
    kind = HalvesDevice

    def writes(self):
        state = self.device.state()
        changed, self.device.told = state != self.device.told, state
        return [state] if changed and any(state.values()) else []


@broken("test_killed_in_mid_write", peer=lambda self: HalvesPeer())
class WritesHalves(UdpStage):
    def perform(self, task, values, inbox):
        steps = struct.pack(">hh", *(round(value / wire.V_PER_STEP) for value in values))
        for place, byte in enumerate(steps):
            self.send(b"B" + bytes([place, byte]))
            time.sleep(0.003 * (place % 2 == 0))


@broken("test_stopped_and_continued")
class CatchesUp(UdpStage):
    done_ns = 0

    def perform(self, task, values, inbox):
        now_ns, period_ns = time.monotonic_ns(), round(1e9 / self.options.command_rate_hz)
        missed = min((now_ns - self.done_ns) // period_ns, 1000) if self.done_ns else 1
        self.done_ns = now_ns
        for _ in range(max(1, missed)):
            super().perform(task, values, inbox)
