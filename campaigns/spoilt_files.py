"""What people do to a configuration file by mistake, and lines that are no requests: nothing may act on them."""

from random import Random

SPOILT = {
    "park out of range": ("park_V: 0", "park_V: 110"),
    "park below range": ("park_V: 0", "park_V: -20.5"),
    "range upside down": ("range_V: [-20, 100]", "range_V: [100, -20]"),
    "range beyond the device": ("range_V: [-20, 100]", "range_V: [-20, 500]"),
    "misspelt key": ("slew_V_per_ms", "slwe_V_per_ms"),
    "misspelt section": ("outputs:", "output:"),
    "misspelt driver": ("    driver: ", "    driver: un"),
    "brace left open": ("park_V: 0}", "park_V: 0"),
    "not a number": ("park_V: 0", "park_V: .nan"),
    "text for a number": ("park_V: 0", "park_V: zero"),
    "no slew": ("slew_V_per_ms: 0.5", "slew_V_per_ms: 0"),
    "ramp of no time": ("ramp_s: 0.3", "ramp_s: 1e-10"),
    "ramp for ever": ("ramp_s: 0.3", "ramp_s: 1e300"),
    "rate of a word": ("rate_hz: 250", "rate_hz: fast"),
    "another axis' output": ("voltage_y, range_V", "voltage_x, range_V"),
    "an output nobody has": ("voltage_y, range_V", "voltage_q, range_V"),
    "empty": (None, ""),
    "cut in half": (None, None),
    "bytes that are no text": (None, "\udcff\udcfe\udc80"),
}
"""Each by its name: what is replaced everywhere, and by what; None as the former is the whole file."""


def spoil(text, how):
    """`text` spoilt, as bytes."""
    old, new = SPOILT[how]
    if new is None:
        return text[: len(text) // 2].encode()
    if old is None:
        return new.encode(errors="surrogateescape")
    assert old in text, f"{how}: {old!r} is not in the file"
    return text.replace(old, new).encode()


def garbage(seed, count=20):
    """So many lines: noise, and requests of which a piece is missing or wrong."""
    draw = Random(seed)
    requests = (b'{"version": 1, "verb": "arm"}', b'{"version": 1, "verb": "set", "changes": {"axes.x.inner": null}}')
    for _ in range(count):
        line = bytearray(draw.choice(requests))
        match draw.randrange(4):
            case 0:
                line = line[: draw.randrange(len(line) - 1)]
            case 1:
                line[draw.choice((0, 1, 2, 9, 10, 12, 15, len(line) - 1))] ^= 0x80
            case 2:
                line = line.replace(b'"version": 1', draw.choice((b'"version": 2', b'"version": "1"', b'"when": 1')))
            case _:
                line = bytearray(byte for byte in draw.randbytes(draw.randrange(200)) if byte != 10)
        yield bytes(line)
