"""Frames out of bytes: however they are cut, whatever lies between them."""

import itertools
import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from micromanip_drivers.line.ascii_text import Lines
from micromanip_drivers.line.frame_options import Crc
from micromanip_drivers.line.frame_reader import STALE_NS, FrameSearch

SYNC = b"\xaa\x55"
CRC32 = Crc(name="crc32.iso_hdlc", byte_order="little")
payloads = st.lists(st.binary(max_size=20), max_size=6)


def search(crc=CRC32):
    """Frames of sync, length of the payload, payload, CRC."""
    tail = crc.size if crc else 0
    return FrameSearch(SYNC, lambda data: None if len(data) < 3 else 3 + data[2] + tail, crc)


def frame(payload, crc=CRC32):
    body = SYNC + bytes((len(payload),)) + payload
    return body + crc.function(body).to_bytes(4, "little") if crc else body


def cut(data, places):
    edges = [0, *sorted(place % (len(data) + 1) for place in places), len(data)]
    return [data[begin:end] for begin, end in itertools.pairwise(edges)]


def fed(found, chunks):
    return [one for number, chunk in enumerate(chunks) for one, _ in found.feed(chunk, number)]


@given(payloads, st.lists(st.integers(0, 1000), max_size=30))
def test_any_cutting_gives_the_same_frames(contents, places):
    frames = [frame(content) for content in contents]
    found = search()
    assert fed(found, cut(b"".join(frames), places)) == frames
    assert found.bad == found.skipped == 0


@settings(max_examples=300)
@given(st.lists(st.tuples(st.binary(max_size=30), st.binary(max_size=20))), st.lists(st.integers(0, 2000), max_size=40))
@example([(b"\xaa\x55\xff", b"abc"), (b"\xaa", b"\x55"), (b"\xaa\x55", b"")], [])
def test_garbage_between_frames_hides_none_and_makes_none(pieces, places):
    """But for the last ones, which a frame that began in the garbage may still be waiting for."""
    frames = [frame(content) for _, content in pieces]
    data = b"".join(garbage + one for (garbage, _), one in zip(pieces, frames, strict=True))
    found = search()
    got = fed(found, [*cut(data, places), bytes(300)])
    assert got == frames


@given(payloads.filter(bool), st.integers(0, 10_000), st.lists(st.integers(0, 1000), max_size=10))
def test_a_flipped_bit_costs_its_frame_and_no_other(contents, bit, places):
    frames = [frame(content) for content in contents]
    data = bytearray(b"".join(frames))
    bit %= 8 * len(data)
    data[bit // 8] ^= 1 << bit % 8
    hit = next(n for n in range(len(frames)) if bit // 8 < sum(map(len, frames[: n + 1])))
    got = fed(search(), [*cut(bytes(data), places), bytes(300)])
    assert got == frames[:hit] + frames[hit + 1 :]


def test_a_short_checksum_that_agrees_by_chance_makes_no_frame():
    """Half a frame and the beginning of the next: with 8 bits one of 256 such pairs adds up."""
    crc, draw, chances = Crc(name="crc8.smbus"), random.Random(7), 0

    def sealed(content):
        body = SYNC + bytes((len(content),)) + content
        return body + bytes((crc.function(body),))

    for _ in range(3000):
        cut_short, whole = sealed(draw.randbytes(16))[: draw.randint(4, 18)], sealed(draw.randbytes(16))
        seeming = (cut_short + whole)[:20]
        chances += crc.function(seeming[:19]) == seeming[19]
        assert fed(search(crc), [cut_short, whole]) == [whole]
    assert chances > 3


def test_frames_have_the_time_of_their_last_byte():
    """Also one that was found late, behind a length that was wrong."""
    first, second = frame(b"one"), frame(b"two")
    found = search()
    assert found.feed(b"\xaa\x55\x40" + first[:4], 1000) == []
    assert found.feed(first[4:] + second[:2], 2000) == []
    assert found.feed(second[2:], 3000) == []
    assert found.feed(bytes(80), 4000) == [(first, 2000), (second, 3000)]


def test_a_frame_that_stands_still_is_given_up():
    """Else the next one would be taken as its rest, and come late or never."""
    found = search()
    assert found.feed(frame(bytes(20))[:10], 0) == []
    assert found.quiet(STALE_NS) == []
    assert found.bad == 0
    assert found.quiet(STALE_NS + 1) == []
    assert found.bad == 1
    assert found.feed(frame(b"new"), STALE_NS + 2) == [(frame(b"new"), STALE_NS + 2)]


def test_without_checksum_a_frame_must_be_followed_by_another():
    """Half a frame and a whole one: what looks like the first frame has the second's beginning in it."""
    found = search(crc=None)
    whole = frame(b"0123456789", crc=None)
    assert fed(found, [whole[:6] + whole + whole]) == [whole, whole]
    assert found.bad == 1


@pytest.mark.parametrize("noise", [b"\xff\xfe\x80\n", b"1=\x00\n", bytes(range(128, 256)) + b"\r"])
def test_noise_is_no_line(noise):
    lines = Lines()
    assert lines.feed(noise + b"1=2\n") == ["1=2"]
    assert lines.noise >= 1


def test_a_line_that_never_ends_is_given_up():
    lines = Lines()
    for _ in range(100):
        assert lines.feed(b"x" * 100) == []
    assert lines.noise >= 1
    *rest, last = lines.feed(b"\nERR\n")
    assert last == "ERR"
    assert all(len(line) < 4096 for line in rest)
