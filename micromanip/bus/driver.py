"""The contract of a bus driver: it talks to its bus, and to nothing else.

A bus driver runs in a worker process of its own (``worker.py``), which owns all that drivers have in common: shared
memory, the schedule, the safe state, reconnection, statistics. So a driver is a Python object that is called by one
thread, may block for a few milliseconds, and says what happened by raising one of the errors of ``errors.py``.

    open      once for each try to reach the device; read_outputs after it
    perform   at the rate of each task: send a frame, ask for registers, write outputs
    receive   between the tasks: take what comes by itself
    close     after every open, also one that failed

``docs/write-a-driver.md`` has a complete example, and the suite that a driver must pass.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from .device_identity import real_because
from .inbox import Inbox
from .watchdog import Watchdog


class BusOptions(BaseModel):
    """Keys that every bus driver has; a driver's own model derives from it. Unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    driver: str = Field(default="", description="Entry point of the driver.")
    simulated: bool = Field(
        default=False,
        strict=True,
        description="The device is `micromanip device simulate`: nothing real moves. Refused for a real serial port, "
        "a CAN interface that is not virtual, or another machine.",
    )
    cpu: int | None = Field(
        default=None,
        strict=True,
        ge=0,
        le=65_535,
        description="CPU of its worker process; null: any but the loop's.",
    )


@dataclass(frozen=True)
class Channel:
    """An input or an output of a bus driver."""

    name: str
    rate_hz: float
    """Declared rate: fresh samples, or writes, a second."""
    latency_s: float = 0.0
    """Input: from being measured to being received, as far as known. Output: from being sent to being in force."""
    safe: float = 0.0
    """Output that the configuration does not use: what it is kept at."""


@dataclass(frozen=True)
class Task:
    """What is done on the bus at a fixed rate: a frame sent, registers asked for."""

    name: str
    rate_hz: float
    outputs: tuple[int, ...] = ()
    """Indices of the outputs that it writes; empty for one that only asks."""
    serves_outputs: bool = False
    """It writes none, but outputs need it (SYNC, a heartbeat): the only such ones that go on where reads must wait."""


@dataclass(frozen=True)
class Load:
    """What a resource of the bus must carry, at worst, for the budget that ``check`` prints."""

    name: str
    share: float
    """Used part of it, 1 is all."""
    detail: str
    """How it comes about, in a few words: "2000 x 145 us + 2000 x 68 us"."""
    limit: float = 0.8


class Outcome(Enum):
    """What became of the outputs of a task, where ``perform`` can't say that the device has them."""

    HELD = "held"
    """Nothing was sent: the line was busy, an answer of before is missing."""
    SENT = "sent"
    """Sent, and still to be answered: ``Inbox.confirm`` is called with the task when the answer has come."""


@dataclass(frozen=True)
class Answer:
    """One thing that was found on a bus by ``device probe``."""

    name: str
    """What answers: "node 5", "message 0x101", "unit 3"."""
    values: Mapping[str, Any]
    """What it says, by name."""
    note: str = ""
    is_value: bool = True
    """Whether a value was read. False where it was refused or left unanswered, or is nothing that is understood: where
    all are so, the probe ends as one that found nothing."""


@dataclass(frozen=True)
class Steady:
    """Two compiled functions that do a driver's ordinary work without Python (``rt/io/worker_loop.py`` calls them)."""

    receive: int
    send: int
    """Their addresses."""
    context: NDArray[Any]
    """The record that both are called with."""
    fileno: Callable[[], int]
    """The descriptor to wait on for what comes, while the link is open."""


class Driver(ABC):
    """What both kinds of driver have; each is found by an entry point in ``micromanip.drivers``."""

    Options: ClassVar[type[BaseModel]]
    """Model of the driver's own keys in the configuration; unknown keys must be refused (extra="forbid")."""

    version: ClassVar[str] = ""
    """Shown by ``micromanip device list``; the version of its package if empty."""

    @property
    @abstractmethod
    def device(self) -> str | None:
        """The hardware that it owns: a second owner of the same one is refused. None where there is none.

        A path ("/dev/ttyUSB0"), "tcp HOST:PORT", "udp HOST:PORT" and "socketcan-INTERFACE" are followed to what they
        lead to, however it was called (``device_identity.py``); any other text stands for itself.
        """

    @property
    def files(self) -> Sequence[Path]:
        """Files that its options name, as seen from the configuration's folder: message databases, say."""
        return ()

    @property
    def real_because(self) -> str | None:
        """Why the device may be a real one, though it may be called simulated; None as far as is seen."""
        return None if self.device is None else real_because(self.device)

    def probe(self, seconds: float) -> Iterator[Answer]:
        """Look, without moving anything, what answers on the bus; what is found, as it is found.

        Called instead of ``open``, on a driver that is not open, and followed by ``close`` if it is a bus': it connects
        by itself, and shows the wrong device too. The newest Answer of a name replaces those before. Raises what
        ``open`` does.
        """
        raise NotImplementedError


class BusDriver(Driver):
    """A driver that runs in a worker process."""

    Options: ClassVar[type[BusOptions]]

    @abstractmethod
    def __init__(self, options: Any, folder: Path) -> None:
        """`options` is a validated ``Options``; names of files in it are seen from `folder`.

        Opens nothing. Raises ConfigError for what only the driver can know.
        """

    @property
    @abstractmethod
    def device(self) -> str:
        """Every bus has one."""

    @property
    def silence(self) -> Watchdog | None:
        """What the device does by itself without commands, and when it is switched on; None: nobody knows.

        Its rest is `safe` of each of `outputs`. Without it a device that can't be read back is written to only after a
        person has said that it rests, once its link was lost.
        """
        return None

    @property
    def watchdog(self) -> str | None:
        """What brings the outputs to a safe value when this machine is dead, in a few words; None if nothing does."""
        return None if self.silence is None else self.silence.words

    @property
    @abstractmethod
    def inputs(self) -> Sequence[Channel]:
        """Its inputs, in a fixed order."""

    @property
    @abstractmethod
    def outputs(self) -> Sequence[Channel]:
        """Its outputs, in a fixed order."""

    @property
    @abstractmethod
    def tasks(self) -> Sequence[Task]:
        """What is to be done at fixed rates."""

    @abstractmethod
    def loads(self) -> Sequence[Load]:
        """What the declared rates cost, with worst-case bits."""

    @abstractmethod
    def open(self) -> None:
        """Reach the device; at most a second. Raises LinkError, or IdentityMismatch for the wrong device.

        Where some of several devices can be served, PartMissing, with the link left open.
        What takes longer raises StillOpening, and is called again without ``close`` until it is open.

        Must not move anything: the first outputs come by ``perform``.
        """

    def read_outputs(self) -> Sequence[float | None]:
        """What the device has on each output, asked right after ``open``; None for what it can't be asked.

        It is what the outputs are led to rest from. Must not move anything; at most half a second; raises as ``open``.
        """
        return [None] * len(self.outputs)

    @abstractmethod
    def perform(self, task: int, values: Sequence[float], inbox: Inbox) -> Outcome | None:
        """Do task number `task` with `values`, one for each output of the driver.

        None says that the device has them, as far as the protocol can tell; else the outcome says what is known of
        them. After an error other than OutputRefused nothing is known.

        Latest value wins: nothing is queued. Raises OutputRefused, with nothing sent, for a value that is not
        finite or that the wire can't carry; TransientError; LinkError; DeviceFault.
        """

    def receive(self, inbox: Inbox, until_ns: int) -> None:
        """Put what came by itself into `inbox`; return soon after the first, and at `until_ns` at the latest.

        `until_ns` (CLOCK_MONOTONIC) may have passed already: then only what is there is taken. Raises TransientError,
        LinkError, DeviceFault. The default is for devices that speak only when they are asked.
        """
        time.sleep(max(0, until_ns - time.monotonic_ns()) * 1e-9)

    def steady(self) -> Steady | None:
        """What serves the open link while nothing out of the ordinary happens; asked once, before the first ``open``.

        None, the default, for a driver that is Python altogether. After a function of these has returned anything but
        0, the next ``receive`` or ``perform`` begins with what it left.
        """
        return None

    @abstractmethod
    def close(self) -> None:
        """Let go of everything that ``open`` took; does no harm twice, never raises, never moves anything."""

    def statistics(self) -> Mapping[str, int]:
        """Counters of its own, since ``__init__``: frames, errors, overflows."""
        return {}

    @classmethod
    def discover(cls, section: Mapping[str, Any], seconds: float) -> tuple[str, Iterator[Answer]]:
        """The device, and what ``probe`` finds where of its section no more than the way to it is true yet."""
        driver = cls(cls.Options.model_validate(section), Path())
        return driver.device, driver.probe(seconds)
