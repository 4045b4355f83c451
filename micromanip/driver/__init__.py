"""The door for drivers: all that a driver's package needs of Micromanip, and the only place it imports from.

    CyclicDriver, Functions, SIGNAL                    a driver that the loop calls (docs/write-a-driver.md)
    SafeOutput, Wire                                   limits of one of its outputs; where its wire stands
    Compiler, entries, now_ns                          what it needs if numba compiles it
    BusDriver, BusOptions, Channel, Task, Load,        a driver in a worker process (docs/write-a-driver.md)
    Inbox, Sample, Outcome, Answer, Steady
    Watchdog                                           what a device does without commands, and when it is switched on
    Section, Typed, Scaled, Written, Commanded,        keys of an option's section, of a number in a device: its type,
    SIZES, PACKED, BITS, number_range                  scale and range; bytes or bits of each type, what it holds
    BusError and those derived from it                 what a bus driver raises
    ConfigError, did_you_mean                          options that make no sense together; a name that nobody knows
    worst_case_s, CLASSIC_LENGTHS, FD_LENGTHS          CAN frames at worst
    real_because, require_regular                      whether a device may be a real one; a file that can be read
    marked_encoding                                    the encoding that a text's byte-order mark names
    read_path_deviation, CheckFailed                   a robot's deviation out of a table; what is wrong with one

``micromanip.driver.quantities`` has types of options with their bounds, ``micromanip.driver.testing`` runs a cyclic
driver in virtual time, ``micromanip.driver.wire`` and ``micromanip.driver.datagrams`` are for one that serves a wire in
the loop itself (tables of frames, datagrams from compiled code), ``micromanip.driver.steady`` and
``micromanip.driver.byte_stream`` for a bus driver with compiled functions (what they say; terminals and TCP), and
``micromanip.driver.conformance`` is the suite that a bus driver must pass, which needs pytest (extra ``dev``). What is
compiled is loaded when it is asked for: a bus driver's worker imports numba only where the driver has compiled
functions (``Steady``).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from micromanip.bus.can_bits import CLASSIC_LENGTHS, FD_LENGTHS, worst_case_s
from micromanip.bus.cyclic import CyclicDriver, Functions, Wire
from micromanip.bus.device_identity import real_because
from micromanip.bus.driver import Answer, BusDriver, BusOptions, Channel, Load, Outcome, Steady, Task
from micromanip.bus.errors import (
    BusError,
    DeviceFault,
    IdentityMismatch,
    LinkError,
    OutputRefused,
    PartMissing,
    StillOpening,
    TransientError,
)
from micromanip.bus.inbox import Inbox, Sample
from micromanip.bus.number_options import BITS, PACKED, SIZES, Commanded, Scaled, Section, Typed, Written, number_range
from micromanip.bus.safe_state import SafeOutput
from micromanip.bus.watchdog import Watchdog
from micromanip.errors import CheckFailed, ConfigError, did_you_mean
from micromanip.files import marked_encoding, require_regular
from micromanip.rt.records import SIGNAL

if TYPE_CHECKING:
    from micromanip.recordings.path_deviation import read_path_deviation
    from micromanip.rt.entries import entries
    from micromanip.rt.intrinsics import now_ns
    from micromanip.rt.jit import Compiler

_LATE = {
    "Compiler": "micromanip.rt.jit",
    "entries": "micromanip.rt.entries",
    "now_ns": "micromanip.rt.intrinsics",
    "read_path_deviation": "micromanip.recordings.path_deviation",
}
"""What imports numba, or readers of files, and where it stands."""


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"micromanip.driver has no {name}")
    from importlib import import_module

    found = globals()[name] = getattr(import_module(_LATE[name]), name)
    return found
