"""Compiled functions and Python say the same of a stream of packets, however it is cut, lost or damaged."""

import math
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from micromanip_drivers.line.stream import StreamFraming
from micromanip_drivers.line.stream_options import Stream

from .compiled_line import Spoken

pytestmark = pytest.mark.compiled_only

TYPES = {"int16": 2, "uint24": 3, "int32": 4, "float32": 4, "float64": 8}


class Layout:
    """A device: how its packets look, drawn by chance, and the next one of them."""

    def __init__(self, draw):
        self.draw = draw
        self.magic, self.serial = bytes(draw.randint(0x80, 0xFF) for _ in range(2)), draw.randint(1, 9)
        self.most = draw.randint(1, 8)
        self.varies, self.counts = draw.random() < 0.6, draw.choice(("packets", "samples", None))
        self.crc = draw.choice(("crc16.modbus", "crc32.iso_hdlc", None))
        self.block, fields = 0, {}
        for k in range(draw.randint(1, 4)):
            kind = draw.choice(list(TYPES))
            fields[f"v{k}"] = {"at": self.block, "type": kind, "byte_order": "big", "scale": draw.choice((1.0, -1e-4))}
            self.block += TYPES[kind]
        little = {"byte_order": "little"}
        self.options = Stream.model_validate(
            {
                "magic": self.magic.hex(),
                "header_bytes": 8,
                "identity": {"serial": {"at": 2, "type": "uint8", "value": self.serial}},
                "status": {"at": 3, "type": "uint8", "good": [0, 4]},
                "blocks": {"at": 4, "type": "uint8", "most": self.most} if self.varies else self.most,
                "counter": {"at": 6, "type": "uint16", **little, "counts": self.counts} if self.counts else None,
                "rate_hz": 1000,
                "block_bytes": self.block,
                "crc": {"name": self.crc, **little} if self.crc else None,
                "fields": fields,
            }
        )
        self.count = draw.choice((0, 65530))

    def packet(self):
        """The next one, after some that were lost, or an old one."""
        draw = self.draw
        blocks = draw.randint(1, self.most) if self.varies else self.most
        self.count += draw.choice((0, 0, 0, 3, 40, -9))
        head = self.magic + bytes((self.serial, draw.choice((0, 0, 4, 7)), blocks, 0))
        data = head + struct.pack("<H", self.count % 65536) + draw.randbytes(blocks * self.block)
        self.count += blocks if self.counts == "samples" else 1
        if self.options.crc:
            crc = self.options.crc
            data += crc.function(data[crc.first :]).to_bytes(crc.size, "little")
        return data

    def said(self):
        """Packets, damaged ones, somebody else's, and what is none."""
        packet = self.packet()
        what = self.draw.random()
        if what < 0.05:
            return packet[: self.draw.randint(0, len(packet) - 1)]
        if what < 0.1:
            return self.draw.randbytes(self.draw.randint(1, 9)) + packet
        if what < 0.15:
            return packet[:2] + bytes((self.serial + 1,)) + packet[3:]
        return packet


def looks(signals, count):
    """What the loop would see of the inputs, but for the times: NaN is one, whatever its payload."""
    return [
        (None if math.isnan(row["value"]) else float(row["value"]).hex(), int(row["status"]), int(row["sequence"]))
        for row in signals[:count]
    ]


@given(st.integers(0, 2**32))
def test_any_stream_gives_the_same_samples(seed):
    draw = random.Random(seed)
    layout = Layout(draw)
    first = layout.packet()
    with Spoken(layout.options, False, StreamFraming) as python, Spoken(layout.options, True, StreamFraming) as ours:
        for one in (python, ours):
            one.begin(first)
        for _ in range(12):
            said = b"".join(layout.said() for _ in range(draw.randint(1, 4)))
            cut = draw.randint(0, len(said))
            for chunk in filter(None, (said[:cut], said[cut:])):
                python.arrives(chunk)
                ours.arrives(chunk)
            count = len(layout.options.fields)
            assert looks(ours.inbox[0]["signal"], count) == looks(python.inbox[0]["signal"], count)
        ours.receive_in_python()  # which takes over what was counted
        python.receive_in_python()
        assert ours.framing.counters == python.framing.counters


def test_whole_packets_never_reach_python():
    layout = Layout(random.Random(7))
    with Spoken(layout.options, True, StreamFraming) as ours:
        ours.begin(layout.packet())
        for _ in range(30):
            assert ours.arrives(layout.packet()) == 0
        assert int(ours.record["frames"]) > 10
