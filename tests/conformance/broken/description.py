"""Drivers that describe themselves wrongly."""

import math
import socket
from dataclasses import replace

from pydantic import model_validator

from conformance.example import UdpStage, UdpStageOptions
from micromanip.bus.driver import Load, Task

from . import broken


@broken("test_class_keeps_the_contract")
class OtherArguments(UdpStage):
    """Perform takes something else."""

    def perform(self, values, inbox):
        super().perform(0, values, inbox)


@broken("test_building_opens_nothing")
class OpensWhenBuilt(UdpStage):
    def __init__(self, options, folder):
        super().__init__(options, folder)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def __del__(self):
        self.close()


class Forgiving(UdpStageOptions):
    @model_validator(mode="before")
    @classmethod
    def drop(cls, data):
        return {key: value for key, value in data.items() if key in cls.model_fields}


@broken("test_unknown_option_is_refused")
class SwallowsTypingErrors(UdpStage):
    Options = Forgiving


def inputs(**changed):
    """A driver whose second input is changed."""

    class Changed(UdpStage):
        @property
        def inputs(self):
            first, second = super().inputs
            return [first, replace(second, **changed)]

    return broken("test_channels")(Changed)


SameName = inputs(name="strain_x")
UnknownLatency = inputs(latency_s=math.nan)


def tasks(check, *described):
    """A driver with these tasks."""

    class Changed(UdpStage):
        @property
        def tasks(self):
            return list(described)

    return broken(check)(Changed)


Unwritten = tasks("test_every_output_is_written_by_one_task", Task("voltages", 500.0, (0,)))
Namesakes = tasks("test_tasks_have_names_and_rates", Task("v", 500.0, (0,)), Task("v", 500.0, (1,)))
OtherRate = tasks("test_tasks_have_names_and_rates", Task("voltages", 250.0, (0, 1)))


def loads(*described):
    """A driver with these loads."""

    class Changed(UdpStage):
        def loads(self):
            return list(described)

    return broken("test_loads")(Changed)


Overloaded = loads(Load("link", 0.9, "too much"))


@broken("test_device_and_watchdog_are_named")
class Nameless(UdpStage):
    device = ""


@broken("test_description_never_changes")
class FindsChannelsWhenOpened(UdpStage):
    @property
    def inputs(self):
        return super().inputs[: 1 if self.socket is None else 2]
