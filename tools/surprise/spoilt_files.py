"""What people do to a configuration file by mistake; what a controller may not take over, and nothing may act on."""

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
