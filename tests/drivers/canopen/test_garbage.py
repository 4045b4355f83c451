"""Frames of nobody at the compiled half of `canopen`. The campaign `fuzz` tries a million."""

import random
import struct

import numpy as np
import pytest
from micromanip_drivers.canbus.plan import Outgoing
from micromanip_drivers.canopen.plan import SYNC

from tests.bus.test_esi import mutated

from .test_compiled_frames import FIELDS, HEARTBEAT, TPDO, compiled, received

pytestmark = pytest.mark.compiled_only

IDENTIFIERS = (TPDO, TPDO, TPDO, SYNC, HEARTBEAT, 0x733, TPDO | 0x80000000, TPDO | 0x40000000, TPDO | 0x20000000)
_CLASSIC_BYTES, _AT_ONCE = 16, 16


def packet(chance, identifier):
    """As the kernel has one, or nearly so."""
    length = chance.choice((8, 8, 8, chance.randrange(9), chance.randrange(256)))
    return struct.pack("<IB3x", identifier, length) + chance.randbytes(8)


def is_pdo(data, length):
    """Whether the kernel would say that this is the PDO, in full length."""
    word, said = struct.unpack_from("<IB", data) if len(data) == _CLASSIC_BYTES else (0, 0)
    return word == TPDO and length <= said <= 8


def test_garbage_at_the_compiled_half(request):
    """Nothing but whole PDOs becomes samples, nothing is sent, and no table changes, whatever comes.

    With NUMBA_BOUNDSCHECK=1 a look outside of a buffer is an error.
    """
    chance, came, left = random.Random(1), 0, 0
    pdo, syncs = received(FIELDS, every=1)
    with compiled(pdo, syncs, sent=[Outgoing((SYNC, False), b""), Outgoing((0x206, False), bytes(8), FIELDS, 0)]) as at:
        tables = at.tables.record[0]
        before = {name: tables[name].tobytes() for name in ("received", "sent", "field", "watched")}
        for _ in range(request.config.getoption("--garbage") // _AT_ONCE):
            for _ in range(_AT_ONCE):
                good = packet(chance, chance.choice(IDENTIFIERS))
                data = good if chance.random() < 0.5 else mutated(chance, good)[:200]
                came += is_pdo(data, pdo.length)
                at.far.send(struct.pack("<q", chance.choice((0, chance.randrange(2**62)))) + data)
            while at.receive() != 0:
                frames = at.tables.left()
                left += len(frames)
                assert all(0 <= len(frame.data) <= 64 for frame, _ in frames)
        assert at.heard() is None
        assert at.tables.counted("pdos") == came > 0
        assert left > 0
        assert {name: tables[name].tobytes() for name in before} == before
        assert np.all(at.signal[len(FIELDS) :] == np.zeros(1, at.signal.dtype)), "of inputs that there are none of"
