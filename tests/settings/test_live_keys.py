"""A key that may be changed while the controller runs reaches whoever uses it.

Every key of the configurations of `every_key` is changed as `set` does it, unless it needs a restart.
Whatever is taken must show in what is handed over then: the parameters that the loop swaps to, what a worker is told,
or another reader that is named here, with the reason.
"""

import re

import every_key
import pytest

from micromanip.errors import ConfigError, UsageError
from micromanip.host import bus_worker
from micromanip.settings.change import needed
from micromanip.settings.check import prepared
from micromanip.settings.schema.key import RESTART
from micromanip.settings.tuning_hash import changes_since

_DESCRIPTOR, _OFFSET = 0, 0


def loop(result):
    """The parameters that the loop swaps to."""
    return result.parameters.tobytes()


def workers(result):
    """What the worker of each bus goes by, those of the configuration that it is told anew when it is swapped."""
    return [bus_worker._orders(result, name, _DESCRIPTOR, _OFFSET) for name in result.wiring.buses]


def warnings(result):
    """What `set` answers beside the changes: which axis is not as it was commissioned."""
    return list(changes_since(result.configuration.axes))


READERS = (loop, workers, warnings)

USED_BY_NOBODY_THAT_RUNS = {
    r"axes\.\*\.hysteresis_affine\b.*": "kept for `evaluate`, which reads the file",
    r"signals\.(true_strain|true_stage|path_error|uncompensated|acceleration)\.max_age_us": "shown, never judged",
}

IS_A_SECTION = (
    *(
        r"reference\.(source|frame|frame\.lever|sines|axes|axes\.\*\.(oscillations|steady))",
        r"axes\.\*\.(outer|commissioned|inner\.notch|actuator|actuator\.resonances|coupling|coupling\.share)",
        r"axes\.\*\.hysteresis\.(model|shaping)",
    ),
)
"""Changed with others: their keys are there in another configuration."""
REFUSED = (
    r"faults\.enable\.reaction",
    r"axes\.\*\.outer\.sample_cycles",
    r"signals\.(?!strain|stage)\w+\.range_um",
    r"signals\.true_\w+\.range_um",
)
"""Has one value, or one that goes with the rates of the sensors, or none."""
CONFIGURATIONS = ("lines", "jog", "sines", "step", "network", "table", "gcs", "tracker", "frame")
"""Quickest first."""


def is_set_aside(key):
    return any(re.fullmatch(pattern, key) for pattern in (*USED_BY_NOBODY_THAT_RUNS, *IS_A_SECTION, *REFUSED))


def other_values(path, value):
    """Values that may be right in place of `value`."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, float | int):
        return [value * 1.01, value * 0.99, value + 1, value - 1, value * 2, value * 0.5]
    if isinstance(value, list):
        varied = []
        for factor in (1.01, 0.99, 0.5):
            varied += [_scaled(value, factor, only) for only in (None, len(value) - 1)]
        return varied
    if value is None:
        return [1.0, 10.0, 100.0, 2, 5_000.0, [-200.0, 300.0]]
    return every_key.shape(path).choices


def _scaled(value, factor, only):
    if isinstance(value, list):
        return [_scaled(each, factor, None) if only in (None, i) else each for i, each in enumerate(value)]
    return value * factor if isinstance(value, float | int) else value


def effect(name, path, value):
    """Who takes the first value that is accepted at `path`; None where none is, or a restart is needed."""
    running = every_key.running(name)
    for other in other_values(path, value):
        try:
            result = every_key.after_set(name, path, other)
        except (ConfigError, UsageError):
            continue
        if result == RESTART:
            return None
        if result is not None:
            taken = [reader.__name__ for reader in READERS if reader(result) != reader(running)]
            return ", ".join(taken) or "nobody"
    return None


def generic(path):
    """The key with names of one's own left out, as the reference has it."""
    if path[0] == "signals":  # what looks at one is another one for each role
        path = ("signals", path[1].rsplit("_", 1)[0], *path[2:])
    named = {"outputs", "axes", "target_um"}
    return ".".join("*" if i and path[i - 1] in named else part for i, part in enumerate(map(str, path)))


@pytest.fixture(scope="module")
def effects():
    """By key: who takes a change of it in the first configuration where anybody does."""
    found = {}
    for name in CONFIGURATIONS:
        for path, value in every_key.places(name).items():
            key = generic(path)
            if needed(path) != RESTART and found.get(key) in (None, "nobody") and not is_set_aside(key):
                found[key] = effect(name, path, value) or found.get(key)
    return found


@pytest.mark.long
def test_every_key_that_is_taken_reaches_somebody(effects):
    """Each key in at least one configuration: the gains of a loop that is open are used by nobody there."""
    assert {key: who for key, who in effects.items() if who in (None, "nobody")} == {}
    assert len(effects) > 120


@pytest.mark.parametrize(
    "key", ["faults.link.silent_ms", "faults.link.loop_silent_ms", "start.ramp_s", "outputs.voltage_x.range_V"]
)
def test_workers_are_told(key):
    path = tuple(key.split("."))
    assert "workers" in effect("gcs", path, every_key.places("gcs")[path])


def test_what_is_read_at_a_start_only_needs_one():
    for key in ("arm_on_start", "simulation.seed"):
        assert needed(tuple(key.split("."))) == RESTART


def test_a_range_that_nobody_looks_at_is_refused():
    document = every_key.document("lines")
    document["signals"]["interlock"]["range_um"] = [0.0, 1.0]
    with pytest.raises(ConfigError, match=r"interlock\.range_um: only strain and stage signals have a range"):
        prepared(every_key.source(document))
