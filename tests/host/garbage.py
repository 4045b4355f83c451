"""Lines that are no request of anybody: mutated, wrong, hostile; none of them may be accepted."""

import json
import random

VERBS = ("status", "arm", "disarm", "hold", "reset", "get", "set", "diff", "save", "reload", "jog", "log")
_ODD = (
    None,
    True,
    -1,
    0,
    1.5,
    1e308,
    "",
    "x",
    "\ud800",
    "axes.x.mode",
    "a" * 300,
    [],
    [1],
    [[]],
    {},
    {"a": 1},
    {"": {}},
)
_BAD_NUMBERS = ("NaN", "-Infinity", "1e999", "1" * 5000)
_SETS = (
    {"axes.x.inner.K_V_per_um": -1.0},
    {"axes.x.inner.K_V_per_um": "fast"},
    {"axes.x.inner": None},
    {"axes": {}},
    {"axes.x.hysteresis.weights[99]": 1},
    {"schema_version": 9},
    {"..": 1},
    {"axes.x.inner.K_V_per_um": 0.5, "axes.x.inner.Ti_ms": -1},
    {"loop.rate_hz": 5000},
    {"drivers.cell.driver": "os.system"},
    {"reference": {"source": "file", "path": "/dev/zero"}},
)


def lines(seed, count):
    """`count` lines of bytes, without their ends, each of which must be refused."""
    draw = random.Random(seed)
    kinds = (_noise, _cut, _flipped, _wrong_version, _wrong_verb, _wrong_fields, _nested, _numbers)
    for number in range(count):
        kind = draw.choice(kinds) if number % 100 else _wrong_set  # which is checked whole, and takes its time
        yield kind(draw).replace(b"\n", b" ").replace(b"\r", b" ")


def _request(draw):
    return json.dumps({"version": 1, "verb": draw.choice(VERBS)}).encode()


def _noise(draw):
    return draw.randbytes(draw.randrange(200))


def _cut(draw):
    line = _request(draw)
    return line[: draw.randrange(len(line))]


def _flipped(draw):
    """One bit of the frame: never one that leaves a request whole."""
    line = bytearray(_request(draw))
    line[draw.choice((0, 1, 2, 9, 10, 12, 14, 15, 16, 20, len(line) - 1))] ^= 0x80
    return bytes(line)


def _wrong_version(draw):
    version = draw.choice((0, 2, 10**30, "1", 1.5, None, True, [1], {"version": 1}))
    return json.dumps({"version": version, "verb": draw.choice(VERBS)}).encode()


def _wrong_verb(draw):
    verb = draw.choice((*_ODD, "ARM", "arm ", " arm", "arm\0", "stop", "__class__", "exit"))
    return json.dumps({"version": 1, "verb": verb}).encode()


def _wrong_fields(draw):
    names = ("changes", "keys", "force", "axis", "by_um", "last", "now", "version ", "")
    fields = {draw.choice(names): draw.choice(_ODD) for _ in range(draw.randrange(1, 4))} | {"unheard_of": 1}
    return json.dumps({"version": 1, "verb": draw.choice(VERBS), **fields}).encode()


def _wrong_set(draw):
    return json.dumps({"version": 1, "verb": "set", "changes": draw.choice(_SETS)}).encode()


def _nested(draw):
    depth = draw.choice((10, 40, 500, 5000))
    opened, closed = draw.choice(((b"[", b"]"), (b'{"a":', b"}")))
    return b'{"version": 1, "verb": "set", "changes": ' + opened * depth + b"1" + closed * depth + b"}"


def _numbers(draw):
    number = draw.choice(_BAD_NUMBERS).encode()
    return b'{"version": 1, "verb": "jog", "axis": "x", "to_um": ' + number + b"}"
