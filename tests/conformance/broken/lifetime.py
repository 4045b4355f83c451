"""Drivers that open and close wrongly."""

import contextlib
import os
from typing import ClassVar

from conformance.example import UdpStage
from micromanip.bus.errors import LinkError, TransientError

from . import broken


@broken("test_opened_100_times_leaves_nothing_behind")
class LeaksDescriptors(UdpStage):
    left: ClassVar = []

    def open(self):
        super().open()
        self.left.append(os.dup(self.socket.fileno()))

    @classmethod
    def tidy(cls):
        for descriptor in cls.left:
            os.close(descriptor)
        cls.left.clear()


@broken("test_closing_twice_and_unopened")
class ClosesOnce(UdpStage):
    def close(self):
        self.socket.close()
        self.socket = None


@broken("test_no_device_is_a_lost_link_within_a_second")
class CallsItTransient(UdpStage):
    def open(self):
        try:
            super().open()
        except LinkError as problem:
            raise TransientError(str(problem)) from problem


@broken("test_closing_after_a_failed_open")
class ForgetsWhatFailed(UdpStage):
    left: ClassVar = []

    def open(self):
        try:
            super().open()
        except LinkError:
            self.left.append(self.socket)
            self.socket = None
            raise

    @classmethod
    def tidy(cls):
        for left in cls.left:
            left.close()
        cls.left.clear()


@broken("test_another_device_is_refused")
class TakesAnyDevice(UdpStage):
    def ask_who(self):
        super().ask_who()
        return self.options.serial_number


@broken("test_opening_and_closing_move_nothing")
class ZeroesWhenOpened(UdpStage):
    def open(self):
        super().open()
        self.perform(0, [0.0, 0.0], None)


@broken("test_opening_and_closing_move_nothing")
class ZeroesWhenClosed(UdpStage):
    def close(self):
        if self.socket is not None:
            with contextlib.suppress(LinkError):
                self.perform(0, [0.0, 0.0], None)
        super().close()
