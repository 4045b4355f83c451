"""Two terminals: one that is written and read, one that is only read; and digital ones."""

from micromanip.emulation.ethercat.terminal import Entry, Terminal

AMPLIFIER = Terminal(
    "Piezo amplifier",
    vendor=0x1234,
    product=0x10,
    revision=3,
    serial=1001,
    outputs={
        0x1600: [Entry(0x7000, k, 32, f"voltage_{k}") for k in (1, 2, 3)],
        0x1601: [Entry(0x7001, 1, 8, "enable"), Entry(0x7001, 2, 8, "feed_hold")],
    },
    inputs={0x1A00: [Entry(0x6000, 1, 8, "ok"), Entry(0x6000, 2, 8, "cool")]},
    settings={(0x8000, 1): b"\1\0", (0x8001, 1): bytes(8)},
)
GAUGE = Terminal(
    "Strain gauge",
    vendor=0x1234,
    product=0x20,
    revision=2,
    serial=1002,
    inputs={0x1A00: [Entry(0x6000, k, 32, f"strain_{k}") for k in (1, 2, 3)]},
)
PINS_OUT = [
    Terminal(
        f"Digital outputs {k}",
        vendor=0x1234,
        product=0x40,
        revision=1,
        serial=k,
        outputs={0x1600 + i: [Entry(0x7000 + 16 * i, 1, 1, f"output_{i}")] for i in range(4)},
        is_digital=True,
    )
    for k in (1, 2)
]
PINS_IN = Terminal(
    "Digital inputs",
    vendor=0x1234,
    product=0x41,
    revision=1,
    serial=1,
    inputs={0x1A00 + i: [Entry(0x6000 + 16 * i, 1, 1, f"input_{i}")] for i in range(8)},
    is_digital=True,
)
LINES = {"cell": [AMPLIFIER, GAUGE], "digital": [*PINS_OUT, PINS_IN]}
"""By name, for ``play.py``."""
