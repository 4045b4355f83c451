"""Configurations that together have every key of the file, the places of their values, and `set` on each of them."""

import copy
import functools

from campaigns.report import CONFIG
from micromanip.settings.change import leaves, needs
from micromanip.settings.check import prepared, revise, validate_with_options
from micromanip.settings.schema.key import RESTART
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.shape import Shape
from micromanip.settings.text.source import Source, key_text

PAPER_CELL = CONFIG / "paper.yaml"


def _read(name):
    return Source.read(CONFIG / f"{name}.yaml").data


def _one_axis(document):
    """Axis x alone: a third of the time."""
    for section in ("signals", "outputs"):
        document[section] = {key: entry for key, entry in document[section].items() if not key.endswith(("_y", "_z"))}
    document["axes"] = {"x": document["axes"]["x"]}
    return document


def _simulated(**sections):
    document = _one_axis(Source.read(PAPER_CELL).data)
    document["arm_on_start"] = False
    document.update(copy.deepcopy(sections))
    return document


_NETWORK = {
    "model": "network",
    "range_um": [0.0, 130.0],
    "reversal_um": 1.0,
    "input_weights": [[0.01, 0.01, 0.01], [0.02, -0.01, 0.01]],
    "input_biases": [0.1, -0.1],
    "output_weights": [10.0, 20.0],
    "output_bias": 5.0,
}
_TABLE = {
    "model": "pi",
    "range_um": [0.0, 130.0],
    "shaping": "table",
    "table_V": [-20.0, 60.0, 150.0],
    "table_um": [-16.0, 48.0, 120.0],
    "thresholds_um": [5.0, 10.0],
    "weights": [0.1, 0.08],
    "creep_s": [0.5],
    "creep_gains": [0.02],
}
_SOFT = {
    "K_V_per_um": 0.05,
    "Ti_ms": 5.0,
    "Td_ms": 0.0,
    "filter_ms": 0.3,
    "notch": {"frequency_Hz": 66.0, "width_Hz": 20.0, "depth_percent": 90.0},
}
_ACTUATOR = {
    "delay_us": 190.0,
    "gauge_us": 64.0,
    "lag_us": 177.0,
    "feedback_percent": 80.0,
    "resonances": [
        {"resonance_Hz": 63.0, "resonance_damping": 0.04, "antiresonance_Hz": 67.0, "antiresonance_damping": 0.038}
    ],
}
_FRAME = {"signals": ["tracker_a"], "matrix": [[1.0]], "offset_um": [0.5]}


def _framed():
    document = _simulated()
    document["signals"]["tracker_a"] = document["signals"].pop("deviation_x") | {"channel": "deviation_x"}
    document["reference"] |= {"frame": _FRAME, "oscillation_range_percent": 50.0}
    document["axes"]["x"]["coupling"] = {"decouple": True}
    swinging = [{"frequency_Hz": 7.8, "um_per_s": 2.0, "decay_per_s": 0.1, "range_percent": 9.0}]
    document["reference"]["axes"] = {"x": {"oscillations": swinging, "jerk_um_per_s3": 300.0, "noise_um": 0.4}}
    document["reference"]["axes"]["x"]["steady"] = {"jerk_um_per_s3": 200.0, "returns_Hz": 0.5}
    return document


def _in_strain(reference, **axis):
    document = _simulated(reference=reference)
    document["axes"]["x"] |= {"mode": "strain", "outer": None, **copy.deepcopy(axis)}  # its gains take a long time
    document["signals"].pop("deviation_x")
    return document


def _with_lines():
    """Digital lines and switches, every optional section of the simulated cell, and all that is null by default."""
    document = _in_strain({"source": "hold", "offset_um": 60.0})
    document.update(
        switches={
            "amplifier_enable": {"driver": "cell", "channel": "amplifier_enable"},
            "feed_hold": {"driver": "cell", "channel": "feed_hold"},
            "heartbeat": {"driver": "cell", "channel": "heartbeat", "period_ms": 20.0},
        },
        start={"check_s": 0.2},
        control={"operate_group": "root"},
        simulation={"driver": "simulated", "lines": {"heartbeat_ms": 50.0}},
    )
    cell = document["drivers"]["cell"]
    cell |= {
        "device": "bench",
        "lines": {"retract_s": 0.5, "heartbeat_ms": 50.0},
        "bus": {"input_rate_Hz": 10_000.0, "output_rate_Hz": 10_000.0},
        "faults": [{"channel": "strain_x", "kind": "offset", "value": 1.0, "at_s": 1.0, "for_s": 2.0}],
        "variation": {"x": {"damping": 0.05}},
        "tracker": {"coordinates": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]},
        "couplings": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    }
    for line in ("enable", "interlock", "retracted", "amplifier_ok_x", "temperature_ok_x"):
        document["signals"][line] = {"driver": "cell"}
    return document


def _on_bus(name):
    document = _one_axis(_read(name))
    document["axes"]["x"] |= {"mode": "strain", "outer": None}
    document["reference"] = {"source": "hold", "offset_um": 60.0}
    return document


_MAKERS = {
    "lines": _with_lines,
    "jog": lambda: _in_strain(
        {"source": "jog", "offset_um": 60.0, "range_um": [40.0, 80.0], "speed_um_per_s": 50.0, "target_um": {"x": 65.0}}
    ),
    "sines": lambda: _in_strain(
        {
            "source": "sine",
            "offset_um": 60.0,
            "sines": [{"amplitude_um": 20.0, "frequency_Hz": 5.0, "phase_deg": 30.0}],
        },
        actuator=_ACTUATOR,
    ),
    "step": lambda: _in_strain({"source": "step", "offset_um": 60.0, "step_um": 5.0, "start_s": 1.0}),
    "network": lambda: _in_strain({"source": "hold", "offset_um": 60.0}, hysteresis=_NETWORK, inner=_SOFT),
    "table": lambda: _in_strain({"source": "hold", "offset_um": 60.0}, hysteresis=_TABLE, inner=_SOFT),
    "voltage": lambda: _in_strain({"source": "hold", "offset_um": 60.0}, mode="voltage"),
    "tracker": _simulated,
    "frame": _framed,
    **{bus: functools.partial(_on_bus, bus) for bus in ("can", "canopen", "gcs", "modbus", "modbus_rtu", "serial")},
}
NAMES = tuple(_MAKERS)


@functools.cache
def _document(name):
    return _MAKERS[name]()


def document(name):
    """A copy of the configuration of that name, with all defaults left out."""
    return copy.deepcopy(_document(name))


@functools.cache
def running(name):
    """It, ready to run."""
    return prepared(source(document(name)))


def source(document):
    """It as it comes from a command, with no file of its own; files that it names stand beside the examples."""
    return Source.of(document, CONFIG / "every_key.yaml")


def spelt_out(name):
    """The document with every default."""
    return running(name).configuration.model_dump(mode="json")


def places(name):
    """Every key of the configuration, also those inside a driver's section, with its value."""
    return leaves(spelt_out(name))


def shape(path):
    """What the models allow at a key."""
    return Shape.of(Configuration).at(path)


def after_set(name, path, value):
    """What would be in force after `set`, None where nothing changes, RESTART where that is what it takes.

    Raises ConfigError or UsageError where it is refused.
    """
    before = running(name)
    taken = source(assigned(document(name), spelt_out(name), {key_text(path): value}))
    configuration = validate_with_options(taken)
    wanted = needs(before.configuration, configuration).values()
    if not wanted or RESTART in wanted:
        return RESTART if wanted else None
    return revise(before, configuration, taken)
