"""Processor time of an exchange of the driver `ethercat`, beside the same in C on the same pair of veth interfaces.

One frame of config/ethercat.yaml comes and one goes in each, kernel included. Both take turns, half a period apart, and
must read the same.
"""

from __future__ import annotations

import ctypes
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from micromanip_drivers.ethercat.driver import Ethercat
from micromanip_drivers.ethercat.link import open_interface

from micromanip.bus.cyclic import call_context
from micromanip.bus.datagram_socket import lend
from micromanip.errors import CheckFailed
from micromanip.rt.io.numbers import SIGNED
from micromanip.rt.records import SIGNAL
from micromanip.settings.check import prepare

from .exchange import partner
from .runner import Plan, Result, Skipped
from .twin import compile_c

_PERIOD_NS, _CYCLES = 500_000, 2000
_SENDERS = b"\x10\x10\x10\x10\x10\x10", b"\x10\x10\x10\x10\x10\x14"
_MOST_BYTES, _BATCH, _INPUTS, _OUTPUTS = 1514, 8, 48, 8


class _Number(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("at", "size", "is_signed")),
        *((name, ctypes.c_double) for name in ("scale", "low", "high")),
    )


class _Twin(ctypes.Structure):
    """``struct twin`` of ethercat_twin.c."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("descriptor", "length", "count_at", "working_counter_at")),
        *((name, ctypes.c_int64) for name in ("working_counter", "status_at", "terminals", "inputs", "outputs")),
        *((name, ctypes.c_int64) for name in ("count", "good", "received_ns")),
        ("input", _Number * _INPUTS),
        ("output", _Number * _OUTPUTS),
        ("value", ctypes.c_double * _INPUTS),
        ("given", ctypes.c_double * _OUTPUTS),
        ("step", ctypes.c_double),
        *((name, ctypes.c_uint8 * _MOST_BYTES) for name in ("expected", "fixed", "sent")),
        ("received", ctypes.c_uint8 * _MOST_BYTES * _BATCH),
    )


def run(plan: Plan) -> list[Result]:
    """Nanoseconds an exchange, medians of one run. Raises CheckFailed where the two disagree."""
    driver = prepare(plan.configuration.parent / "ethercat.yaml").wiring.drivers["cell"]
    assert isinstance(driver, Ethercat)
    interface = f"bench{os.getpid() % 1_000_000}"
    context = driver.context()
    c, signals, outputs = driver.record(context), np.zeros(_INPUTS, SIGNAL), np.zeros(_OUTPUTS)
    taken = np.zeros((_CYCLES, 2), np.int64)
    with tempfile.TemporaryDirectory() as folder, _terminals(interface, c):
        harness = compile_c("ethercat_twin.c", Path(folder)).run
        near, far = (open_interface(interface, sender) for sender in _SENDERS)
        twin = _twin(c, far.fileno())
        lend(near.detach(), c["socket"])
        functions = driver.functions()
        call_context(functions.open, context.ctypes.data)
        try:
            plan.tell(f"ethercat_exchange: {_CYCLES} exchanges of each")
            harness(
                ctypes.c_void_p(functions.exchange),
                *(ctypes.c_void_p(each) for each in (context.ctypes.data, signals.ctypes.data)),
                ctypes.byref(twin),
                ctypes.c_void_p(outputs.ctypes.data),
                *(ctypes.c_int64(each) for each in (_CYCLES, _PERIOD_NS)),
                ctypes.c_void_p(taken.ctypes.data),
            )
        finally:
            call_context(functions.close, context.ctypes.data)
            far.close()
    _require_agreement(c, signals, twin)
    value, reference = np.median(taken, axis=0)
    return [Result.of("ethercat_exchange", float(value), "ns", "the same in C, gcc -O3", float(reference))]


def _twin(c: Any, descriptor: int) -> _Twin:
    """With the tables of the driver's own."""
    received, sent = c["receive"], c["send"]
    twin = _Twin(descriptor=descriptor, length=int(sent["length"]), count_at=int(sent["counter"]["at"]), step=1e3)
    for name in ("working_counter_at", "working_counter", "status_at", "terminals"):
        setattr(twin, name, int(c[name]))
    twin.inputs, twin.outputs = _fill(twin.input, received), _fill(twin.output, sent)
    frames = {"expected": received["template"], "fixed": received["fixed"], "sent": sent["template"]}
    for name, data in frames.items():
        getattr(twin, name)[: len(data)] = data.tobytes()
    last = len(_SENDERS[1]) + 5
    twin.expected[last] = twin.sent[last] = _SENDERS[1][-1]
    return twin


def _fill(numbers: Any, frame: Any) -> int:
    """As many as the frame has."""
    for number, n in zip(numbers, frame["number"][: frame["numbers"]], strict=False):
        number.at, number.size, number.is_signed = int(n["at"]), int(n["size"]), int(n["kind"] == SIGNED)
        number.scale, number.low, number.high = float(n["scale"]), float(n["low"]), float(n["high"])
    return int(frame["numbers"])


def _require_agreement(c: Any, signals: Any, twin: _Twin) -> None:
    inputs = int(c["receive"]["numbers"])
    ours, theirs = signals["value"][:inputs], np.array(twin.value[:inputs])
    fresh = int(signals["sequence"][0])
    if min(fresh, twin.good) < _CYCLES // 2 or not np.array_equal(ours, theirs):
        raise CheckFailed(
            f"with {fresh} and {twin.good} fresh frames of {_CYCLES} they read {ours.tolist()} and {theirs.tolist()}"
        )


@contextmanager
def _terminals(interface: str, c: Any) -> Iterator[None]:
    """They answer at the far end of a veth pair of their own."""
    inputs_at = c["receive"]["number"]["at"][: c["receive"]["numbers"]].min()
    numbers = inputs_at, c["terminals"], c["working_counter_at"], c["working_counter"], c["status_at"]
    with partner("terminals", interface, *(int(n) for n in numbers)) as said:
        if said != "up":
            raise Skipped(said)
        yield
