"""Drivers that read wrongly."""

import time
import zlib

from conformance.example import UdpStage, wire
from micromanip.bus.inbox import Inbox

from . import broken


class Changed(UdpStage):
    def receive(self, inbox, until_ns):
        own = Inbox()
        try:
            super().receive(own, until_ns)
        finally:
            for sample in own:
                self.change(sample)
                inbox.put(sample.channel, sample.value, sample.time_ns, sample.status, sample.lost)


@broken("test_samples_come")
class OneEyed(UdpStage):
    def receive(self, inbox, until_ns):
        own = Inbox()
        super().receive(own, until_ns)
        for sample in own:
            if sample.channel == 0:
                inbox.put(0, sample.value, sample.time_ns, lost=sample.lost)


@broken("test_receive_keeps_its_deadline_under_a_silent_device")
class WaitsForever(UdpStage):
    def arrived(self, wait_s):
        return super().arrived(max(wait_s, 1.0))


@broken("test_perform_does_not_block_under_a_silent_device")
class AwaitsTheAnswer(UdpStage):
    def perform(self, task, values, inbox):
        super().perform(task, values, inbox)
        self.arrived(1.0)


@broken("test_receive_returns_soon_after_the_first")
class Collects(UdpStage):
    def receive(self, inbox, until_ns):
        super().receive(inbox, until_ns)
        time.sleep(max(0, until_ns - time.monotonic_ns()) * 1e-9)


@broken("test_golden_inputs")
class WrongByteOrder(UdpStage):
    def take(self, datagram, inbox):
        if datagram[:1] == b"S" and len(datagram) == wire.STRAINS.size + 4:
            body = datagram[:2] + datagram[5:1:-1] + datagram[9:5:-1]
            datagram = body + zlib.crc32(body).to_bytes(4, "big")
        return super().take(datagram, inbox)


@broken("test_garbage_gives_no_sample")
class Credulous(UdpStage):
    def take(self, datagram, inbox):
        body = datagram[:-4]
        return super().take(body + zlib.crc32(body).to_bytes(4, "big"), inbox)


@broken("test_partial_frames_give_no_sample")
class FillsUp(UdpStage):
    def take(self, datagram, inbox):
        if datagram[:1] == b"S" and 6 <= len(datagram) < wire.STRAINS.size + 4:
            body = datagram[: wire.STRAINS.size].ljust(wire.STRAINS.size, b"\0")
            datagram = body + zlib.crc32(body).to_bytes(4, "big")
        return super().take(datagram, inbox)


@broken("test_gaps_of_the_counter_are_lost_samples")
class IgnoresTheCounter(Changed):
    def change(self, sample):
        sample.lost = 0


@broken("test_wrap_of_the_counter_is_no_gap")
class NeverWraps(UdpStage):
    def take(self, datagram, inbox):
        if self.counter is not None and datagram[:1] == b"S" and datagram[1] < self.counter:
            self.counter = None
        return super().take(datagram, inbox)


@broken("test_time_stamps")
class WallClock(Changed):
    def change(self, sample):
        sample.time_ns = time.time_ns()
