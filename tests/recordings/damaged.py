"""A recording with a bit that has turned over, found by MCAP's own reader."""

from mcap.reader import make_reader


def damage(file, share):
    """Spoil a byte in the middle of the chunk of rows that lies so far into the file (0..1)."""
    with file.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    rows = sorted((each.chunk_start_offset, each.chunk_length) for each in chunks if each.chunk_length > 1000)
    place, length = rows[int(share * len(rows))]
    content = bytearray(file.read_bytes())
    content[place + length // 2] ^= 0xFF
    file.write_bytes(content)
