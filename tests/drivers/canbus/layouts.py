"""Random messages for the comparison with cantools: signals of any size, order and type that do not overlap."""

from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import strategies as st

SCALES = (1, 2, -1, 0.5, 0.001, -0.0025, 1e-4)
OFFSETS = (0, -20, 0.25, 1000)


@st.composite
def messages(draw):
    """A message whose bits are dealt out to signals one after the other, in Intel or in Motorola counting."""
    length = draw(st.sampled_from((1, 2, 3, 8, 12, 24, 64)))
    signals = []
    halves = [(0, length)] if length < 3 else [(0, length // 3), (length // 3, length)]
    for first, end in halves:  # one byte order to each part: then nothing overlaps by construction
        big_endian = draw(st.booleans())
        position, stop = 8 * first, 8 * end
        while position < stop and len(signals) < 12:
            position += draw(st.integers(0, 5))
            is_float = draw(st.booleans())
            bits = draw(st.sampled_from((16, 32, 64)) if is_float else st.integers(1, 64))
            if position + bits > stop:
                break
            signals.append(draw(_signal(f"s{len(signals)}", position, bits, big_endian, is_float)))
            position += bits
    if not signals:
        signals.append(draw(_signal("s0", 0, 8, False, False)))
    return Message(frame_id=1, name="M", length=length, signals=signals, is_fd=length > 8)


@st.composite
def _signal(draw, name, position, bits, big_endian, is_float):
    start = 8 * (position // 8) + 7 - position % 8 if big_endian else position
    scale, offset = (1, 0) if is_float else (draw(st.sampled_from(SCALES)), draw(st.sampled_from(OFFSETS)))
    return Signal(
        name,
        start,
        bits,
        byte_order="big_endian" if big_endian else "little_endian",
        is_signed=draw(st.booleans()) and not is_float and bits > 1,
        conversion=BaseConversion.factory(scale=scale, offset=offset, is_float=is_float),
    )
