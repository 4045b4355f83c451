"""Compiled functions and Python say the same of every PDO, bit for bit; what else comes is Python's."""

import contextlib
import socket
import struct
import time
from types import SimpleNamespace

import can
import numpy as np
import pytest
from can.interfaces.socketcan.socketcan import build_can_frame
from canopen.objectdictionary import datatypes
from hypothesis import example, given
from hypothesis import strategies as st
from micromanip_drivers.canbus.plan import Outgoing
from micromanip_drivers.canopen import exchange
from micromanip_drivers.canopen.driver import PdoTables
from micromanip_drivers.canopen.mapping import Mapped
from micromanip_drivers.canopen.plan import SYNC, wire
from micromanip_drivers.canopen.receiving import ReceivedPdo
from micromanip_drivers.canopen.sampling import Sampling, SyncTimes

from micromanip.bus.driver import Steady
from micromanip.bus.inbox import Inbox
from micromanip.rt.io.worker_records import INBOX

from ..compiled_turns import call_receive, call_send

pytestmark = pytest.mark.compiled_only

TPDO, HEARTBEAT = 0x185, 0x705
PERIOD, FRAME, LATENCY, SYNC_NS, WAITING = 1_000_000, 115_000, 40_000, 47_000, 300_000
SCALED = SimpleNamespace(scale=1e-4, offset=0.0)
FIELDS = [
    wire(f"v{k}", Mapped(SimpleNamespace(data_type=kind, min=None, max=None), bit, bits), SCALED)
    for k, (kind, bit, bits) in enumerate(((datatypes.INTEGER16, 0, 16), (datatypes.UNSIGNED24, 20, 24)))
]


def received(fields, every=0):
    """The PDO, and the SYNCs that it may answer."""
    syncs, length = SyncTimes(), max((field.shift + field.bits + 7) // 8 for field in fields)
    pdo = SimpleNamespace(
        mapping=SimpleNamespace(identifier=TPDO, length=length),
        options=SimpleNamespace(rate_hz=100.0),
        wires=fields,
        title="tpdo 1 of node sensor",
    )
    return ReceivedPdo(pdo, 0, 0.0, Sampling(syncs, every, FRAME, LATENCY, PERIOD, WAITING)), syncs


class At:
    """The compiled functions at one end of a pair of sockets, with frames that say when they came."""

    def __init__(self, ends, pdo=None, syncs=None, sent=()):
        self.near, self.far = ends
        pdos = [] if pdo is None else [pdo]
        task = next((i for i, one in enumerate(sent) if one.identity[0] == SYNC), -1)
        self.tables = PdoTables(pdos, sent, [HEARTBEAT, SYNC], syncs or SyncTimes(), (task, SYNC_NS))
        self.tables.hold(self.near.fileno(), 8, time.monotonic_ns())
        self.tables.expect_heartbeats(2**62)
        self.inbox = np.zeros(1, INBOX)
        self.functions = Steady(*exchange.ENTRIES.addresses, self.tables.record, self.near.fileno)

    def arrives(self, data, time_ns=0, identifier=TPDO):
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        self.far.send(struct.pack("<q", time_ns) + build_can_frame(message))

    def receive(self, began_ns=0):
        return call_receive(self.functions, self.inbox, began_ns)

    def send(self, values=(), task=0):
        return call_send(self.functions, values, task)

    def heard(self):
        """What was sent; None for nothing."""
        try:
            return self.far.recv(256)[8:]
        except BlockingIOError:
            return None

    @property
    def signal(self):
        return self.inbox[0]["signal"]


@contextlib.contextmanager
def compiled(*what, **more):
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        near.setblocking(False)
        far.setblocking(False)
        yield At((near, far), *what, **more)


LOST = [(1, "s"), (200, "a"), (800, "s"), (1000, "s"), (1000, "s"), (200, "b")]
"""Two SYNCs without an answer."""


@example(1, LOST)
@given(st.integers(0, 3), st.lists(st.tuples(st.integers(1, 1500), st.sampled_from("saab")), max_size=40))
def test_a_pdo_is_dated_and_counted_the_same_whoever_takes_it(every, events):
    """By turns in compiled code and in Python, and beside it in Python alone."""
    (reference, syncs), (shared, shared_syncs) = received(FIELDS, every), received(FIELDS, every)
    at_ns = 0
    with compiled(shared, shared_syncs) as at:
        for number, (later_us, what) in enumerate(events):
            at_ns += later_us * 1_000
            if what == "s":
                syncs.add(at_ns)
                shared_syncs.add(at_ns)
                continue
            data, alone, ours = what.encode() * reference.length, Inbox(), Inbox()
            reference.take(data, at_ns, alone)
            if number % 3 == 0:
                shared.take(data, at_ns, ours)
                assert list(ours) == list(alone)
                continue
            before, missing = int(at.signal[0]["sequence"]), int(at.inbox[0]["missing"][0])
            at.arrives(data, at_ns)
            assert at.receive() == 0
            sample = next(iter(alone), None)
            assert int(at.signal[0]["sequence"]) - before == (1 + sample.lost if sample else 0)
            assert int(at.inbox[0]["missing"][0]) - missing == (sample.lost if sample else 0)
            assert sample is None or int(at.signal[0]["time_ns"]) == sample.time_ns
        for name in ("pdos", "lost", "repeated"):
            assert getattr(shared, name) + at.tables.counted(name) == getattr(reference, name)


def test_a_sync_that_compiled_code_sent_dates_the_answer():
    pdo, syncs = received(FIELDS, every=1)
    with compiled(pdo, syncs, sent=[Outgoing((SYNC, False), b"")]) as at:
        before_ns = time.monotonic_ns()
        assert at.send() == 0
        after_ns = time.monotonic_ns()
        assert at.heard() == build_can_frame(can.Message(arbitration_id=SYNC, is_extended_id=False))
        (sent_ns,) = (int(at_ns) for at_ns in syncs.record["sent_ns"] if at_ns)
        assert before_ns <= sent_ns - SYNC_NS <= after_ns, "a frame has a length"
        while time.monotonic_ns() < sent_ns + FRAME + 1:  # what is said to come later than now comes now
            pass
        at.arrives(bytes(pdo.length), sent_ns + FRAME + 1)
        assert at.receive() == 0
        assert int(at.signal[0]["time_ns"]) == sent_ns - LATENCY


def test_heartbeats_are_pythons_and_hold_up_no_sample():
    pdo, syncs = received(FIELDS)
    with compiled(pdo, syncs) as at:
        at.arrives(b"\x05", identifier=HEARTBEAT)
        at.arrives(bytes(pdo.length))
        at.arrives(bytes(pdo.length - 1))  # too short
        at.arrives(b"\x05", identifier=0x733)  # nobody's
        assert at.receive() == 1
        assert int(at.signal[0]["sequence"]) == 1, "the PDO behind the heartbeat"
        assert at.receive() == 1, "Python first"
        assert [(m.arbitration_id, len(m.data)) for m, _ in at.tables.left()] == [
            (HEARTBEAT, 1),
            (TPDO, pdo.length - 1),
        ]
        assert at.receive() == 0
