"""How long CAN and CAN FD frames take at worst: with every stuff bit that their content can ask for.

A classic frame with an 11-bit identifier and n bytes has 34 + 8n bits that are stuffed, from its start to its CRC:
after five equal bits one is inserted, which counts itself, so at most one for every four after the first. Then come 10
bits (delimiters, acknowledgement, end of frame) and the 3 of the intermission: 8n + 47 + (33 + 8n) // 4 in all.

A CAN FD frame (ISO 11898-1) that switches the bit rate sends what comes before the ESI bit, and what comes after the
CRC delimiter, at the nominal rate. BRS bit and CRC delimiter change the rate at their sample points; together they
take one nominal and one data bit if both rates have the same sample point, so BRS counts as nominal and the delimiter
as data. Its CRC field has fixed stuff bits: one first, and one after every four bits of stuff count (4) and CRC (17 up
to 16 bytes, 21 above). Dynamic stuff bits count as nominal as far as they can fall there.
"""

from __future__ import annotations

CLASSIC_LENGTHS = tuple(range(9))
FD_LENGTHS = (*CLASSIC_LENGTHS, 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a frame can carry."""

_TAIL_BITS = 1 + 1 + 7 + 3  # acknowledgement and its delimiter, end of frame, intermission
_ERROR_FRAME_BITS = 12 + 8 + 3  # both nodes' flags one after the other, delimiter, intermission


def fd_length(length: int) -> int:
    """The shortest payload of CAN FD that holds `length` bytes. Raises ValueError for none of 0 to 64."""
    for fits in FD_LENGTHS:
        if 0 <= length <= fits:
            return fits
    raise ValueError(f"a CAN FD frame carries 0 to 64 bytes, not {length}")


def classic_bits(length: int, extended: bool = False) -> int:
    """Bits of a classic frame of `length` bytes, at worst, with the intermission.

    Raises ValueError for none of 0 to 8.
    """
    if length not in CLASSIC_LENGTHS:
        raise ValueError(f"a classic CAN frame carries 0 to 8 bytes, not {length}")
    stuffed = (54 if extended else 34) + 8 * length
    return stuffed + (stuffed - 1) // 4 + 1 + _TAIL_BITS  # the 1 is the CRC delimiter


def fd_bits(length: int, extended: bool = False) -> tuple[int, int]:
    """Bits of a CAN FD frame of `length` bytes at the nominal and at the data bit rate, at worst.

    A length that CAN FD doesn't have takes what the next longer takes. Raises ValueError for none of 0 to 64.
    """
    length = fd_length(length)
    header = 36 if extended else 17  # start of frame up to BRS
    payload = 1 + 4 + 8 * length  # ESI, length code, data
    header_stuff = (header - 1) // 4
    payload_stuff = (header + payload - 1) // 4 - header_stuff
    counted = 4 + (17 if length <= 16 else 21)  # stuff count and CRC
    fixed_stuff = 1 + counted // 4
    return header + header_stuff + _TAIL_BITS, payload + payload_stuff + counted + fixed_stuff + 1


def worst_case_s(length: int, bitrate: int, data_bitrate: int | None = None, extended: bool = False) -> float:
    """Seconds that a frame of `length` bytes keeps the bus, at worst, with the intermission after it.

    With `data_bitrate` it is a CAN FD frame that switches to it; one that doesn't switch has ``data_bitrate=bitrate``.
    Raises ValueError for a length that the frame can't have.
    """
    if data_bitrate is None:
        return classic_bits(length, extended) / bitrate
    nominal, data = fd_bits(length, extended)
    return nominal / bitrate + data / data_bitrate


def error_frame_s(bitrate: int) -> float:
    """Seconds that an error frame keeps the bus, at worst, after the frame that it destroyed."""
    return _ERROR_FRAME_BITS / bitrate
