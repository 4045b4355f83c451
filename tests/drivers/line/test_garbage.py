"""Bytes of nobody in a stream, at its compiled half and at Python behind it; the campaign `fuzz`: a million."""

import random
import struct

import numpy as np
import pytest
from micromanip_drivers.line.stream import StreamFraming
from micromanip_drivers.line.stream_options import Stream

from tests.bus.test_esi import mutated

from .compiled_line import Spoken

pytestmark = pytest.mark.compiled_only

MOST, SERIAL, MARK = 4, 5, 0x5A5A5A5A
MAGIC = b"\xab\xcd"


def options():
    """Packets of up to four blocks, each of two numbers, with counter and checksum."""
    little = {"byte_order": "little"}
    return Stream.model_validate(
        {
            "magic": MAGIC.hex(),
            "header_bytes": 8,
            "identity": {"serial": {"at": 2, "type": "uint8", "value": SERIAL}},
            "status": {"at": 3, "type": "uint8", "good": [0]},
            "blocks": {"at": 4, "type": "uint8", "most": MOST},
            "counter": {"at": 6, "type": "uint16", **little, "counts": "packets"},
            "rate_hz": 1000,
            "block_bytes": 8,
            "crc": {"name": "crc32.iso_hdlc", **little},
            "fields": {"number": {"at": 0, "type": "int32", **little}, "marked": {"at": 4, "type": "int32", **little}},
        }
    )


def packet(chance, framing, number):
    """The next one: each block says the number of the packet, and what comes of it with a mark."""
    blocks = chance.randint(1, MOST)
    head = MAGIC + bytes((SERIAL, 0, blocks, 0)) + struct.pack("<H", number % 65536)
    data = head + blocks * struct.pack("<ii", number, number ^ MARK)
    return data + framing.function(data[framing.first :]).to_bytes(framing.size, "little")


def test_garbage_in_a_stream(request):
    """No sample is of anything but a whole packet, whatever stands between them and inside of them."""
    chance, keys = random.Random(1), options()
    with Spoken(keys, True, StreamFraming) as stream:
        stream.begin(packet(chance, keys.crc, 0))
        signal = stream.inbox[0]["signal"]
        for number in range(1, request.config.getoption("--garbage")):
            good = packet(chance, keys.crc, number)
            what = chance.random()
            said = good if what < 0.5 else chance.randbytes(chance.randrange(1, 60)) if what < 0.6 else b""
            stream.arrives(said or mutated(chance, good)[:500] or MAGIC[:1])
            value, marked = (int(value) for value in signal["value"][:2])
            assert value <= number
            assert marked == value ^ MARK or signal["sequence"][0] == 0
        assert 0 < stream.errors, "some of it was damaged"
        assert signal["sequence"][0] > 0.3 * number
        assert value > number - 1000, "it does not give up"
        assert stream.framing.counters["packets"] > 0.3 * number
        assert np.all(signal[2:] == np.zeros(1, signal.dtype)), "of inputs that there are none of"
        assert not stream.heard(), "a stream is not answered"
