"""Whatever stands at a key, in the file or in `set`: it is taken and everything made of it works, or it is refused.

Refused means a MicromanipError with a documented exit code; never another exception, and never a warning of numpy
(which pytest turns into one).
"""

import copy
import functools
import json
import math

import every_key
import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from micromanip.errors import ConfigError, UsageError
from micromanip.settings.check import prepared
from micromanip.settings.checks.feedback import strain_loops
from micromanip.settings.schema.key import RESTART
from micromanip.settings.wiring.buses import budget

NASTY = [
    *(1e300, -1e300, 1e-300, 1e18, 1e9, 1e6, 1e4, 1e3, 1.0, 0.5, 1e-3, 1e-6, 1e-9, 0.0, -0.0, -1.0, -1e-9, math.nan),
    *(math.inf, -math.inf, 0, 1, 2, 3, -1, 255, 65_535, 2**31, 2**63, 2**64, -(2**63), 10**30, True, False, None),
    *("", " ", "nan", "1e3", "0x10", "\0", "a\0b", "\n", "..", "/", "/dev/zero", "x" * 10_000, "µ" * 300, "😀"),
    *([], {}, [[]], [1, 0], [1.0, 1.0], [0, 1], [math.nan, math.nan], [-1e300, 1e300], [1.0] * 1000, {"": 1}),
    *(["x"] * 3, [None], {"x": None}, [[1.0, 2.0], [1.0]], {"model": "none"}, {"source": "file", "path": "/dev/zero"}),
]  # fmt: skip


def drawn(shape_range, present):
    """What may be wrong at a place: anything; the ends of its range; the present value, a little or much changed."""
    ends = [end for end in shape_range if end is not None]
    near = []
    if isinstance(present, float | int) and not isinstance(present, bool):
        near = [present * factor for factor in (0.0, -1.0, 1e-6, 1e-3, 0.5, 0.999, 1.001, 2.0, 1e3, 1e6)]
        near += [round(each) for each in near if abs(each) < 1e15]
    if isinstance(present, list):
        near = [present[::-1], present[:-1], present + present, [0.0] * len(present), [-1.0] * len(present)]
        near += [[each * f for each in present] for f in (1e-6, 1e3, 1e6) if all(isinstance(e, float) for e in present)]
    return [*near, *ends, *NASTY]


def ends_of(path):
    """Lowest and highest value that the models allow there, as far as they say."""
    shape = every_key.shape(path)
    schema = shape.entry.schema if shape.type == "array" and shape.entry else shape.schema
    return schema.get("minimum"), schema.get("maximum")


def put(document, path, value):
    place = document
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = copy.deepcopy(value)
    return document


def tried_in_the_file(name, path, value):
    try:
        document = put(every_key.spelt_out(name), path, value)
        result = prepared(every_key.source(document))
    except ConfigError as refusal:
        told(refusal)
        return False
    works(result)
    return True


def tried_with_set(name, path, value):
    try:
        result = every_key.after_set(name, path, value)
    except (ConfigError, UsageError) as refusal:
        told(refusal)
        return False
    if result == RESTART:
        return False
    works(result or every_key.running(name))
    return True


def told(refusal):
    """A message for people: no page long, no line without a word of where or what."""
    text = str(refusal)
    assert text.strip()
    assert len(text) < 5_000, text
    assert all(line.isprintable() for line in text.splitlines())


def works(result):
    """Everything that is made of a configuration can be made, and no number of it is none."""
    assert_numbers(result.parameters)
    assert np.isfinite(result.samples).all()
    assert len(result.warnings) == len(result.advice)
    strain_loops(result.configuration, result.wiring)
    for loads in budget(result.wiring).values():
        assert all(math.isfinite(load.share) for load in loads)
    json.dumps(result.configuration.model_dump(mode="json"), allow_nan=False)
    for driver in result.wiring.drivers.values():
        driver.context()


def assert_numbers(record, name="parameters"):
    if record.dtype.names:
        for field in record.dtype.names:
            assert_numbers(record[field], f"{name}.{field}")
    elif record.dtype.kind == "f":
        assert not np.isnan(record).any(), name


@functools.cache
def places():
    """Of all configurations; not made before it is needed."""
    return [(name, path) for name in every_key.NAMES for path in every_key.places(name)]


SEARCHED = 100 if hypothesis.settings.get_current_profile_name() == "steady" else 300


@pytest.mark.long
@hypothesis.settings(max_examples=max(SEARCHED, hypothesis.settings().max_examples))
@given(st.data())
def test_whatever_stands_at_a_key(data):
    name, path = data.draw(st.sampled_from(places()), label="key")
    present = every_key.places(name)[path]
    value = data.draw(st.sampled_from(drawn(ends_of(path), present)) | st.floats() | st.integers(), label="value")
    way = data.draw(st.sampled_from([tried_in_the_file, tried_with_set]), label="way")
    way(name, path, value)


@pytest.mark.parametrize("name", every_key.NAMES)
def test_what_runs_can_be_set_again(name):
    key = ("axes", "x", "authority_percent")
    assert tried_with_set(name, key, 50.0)
    assert tried_in_the_file(name, key, 50.0)
