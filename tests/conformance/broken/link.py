"""Drivers that take a lost link wrongly, and such as cost or count wrongly."""

import time

from conformance.example import UdpStage, wire
from micromanip.bus.driver import Answer
from micromanip.bus.errors import LinkError, TransientError

from . import broken


@broken("test_dead_device_is_a_lost_link")
class NeverGivesUp(UdpStage):
    is_open = False

    def open(self):
        super().open()
        self.is_open = True

    def send(self, datagram):
        try:
            super().send(datagram)
        except LinkError as problem:
            if self.is_open:
                raise TransientError(str(problem)) from problem
            raise

    def receive(self, inbox, until_ns):
        try:
            super().receive(inbox, until_ns)
        except LinkError as problem:
            raise TransientError(str(problem)) from problem

    def close(self):
        self.is_open = False
        super().close()


@broken("test_reopened_after_a_lost_link")
class Resentful(UdpStage):
    lost = False

    def open(self):
        if self.lost:
            raise LinkError("it was lost before")
        super().open()

    def receive(self, inbox, until_ns):
        try:
            super().receive(inbox, until_ns)
        except LinkError:
            self.lost = True
            raise

    def perform(self, task, values, inbox):
        try:
            super().perform(task, values, inbox)
        except LinkError:
            self.lost = True
            raise


@broken("test_closed_driver_raises_bus_errors_only")
class NeedsToBeOpen(UdpStage):
    def send(self, datagram):
        self.socket.fileno()
        super().send(datagram)


@broken("test_flapping_device_raises_bus_errors_only")
class BareErrors(UdpStage):
    def send(self, datagram):
        try:
            super().send(datagram)
        except LinkError as problem:
            raise (problem.__cause__ or problem) from None


@broken("test_silent_device_is_no_bug")
class DividesByNothing(UdpStage):
    def receive(self, inbox, until_ns):
        heard_ns = self.heard_ns
        super().receive(inbox, until_ns)
        if time.monotonic_ns() - heard_ns > 100_000_000:
            self.rate_hz = 1e9 / (self.heard_ns - heard_ns)


@broken("test_load_is_at_most_what_is_declared")
class SendsTwice(UdpStage):
    def perform(self, task, values, inbox):
        super().perform(task, values, inbox)
        super().perform(task, values, inbox)


@broken("test_statistics_only_rise")
class CountsAnew(UdpStage):
    def open(self):
        self.counts = dict.fromkeys(self.counts, 0)
        super().open()


@broken("test_probe_finds_the_device")
class FindsNothing(UdpStage):
    def probe(self, seconds):
        list(super().probe(seconds))
        yield from ()


@broken("test_probe_writes_nothing")
class ProbesByMoving(UdpStage):
    def probe(self, seconds):
        for answer in super().probe(seconds):
            self.send(wire.sealed(wire.VOLTAGES.pack(b"V", 100, 100)))
            yield answer if isinstance(answer, Answer) else None
