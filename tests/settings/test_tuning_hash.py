"""A tuning is known by its hash: the same after it was written and loaded, another one once any key differs."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from campaigns.report import CONFIG
from micromanip.cli.main import main
from micromanip.settings.load import load
from micromanip.settings.schema.axis import Axis, Commissioned, Inner, SetPoint
from micromanip.settings.tuning_hash import tuning_hash
from micromanip.settings.write import with_tuning

PAPER = CONFIG / "paper.yaml"
TEXT = PAPER.read_text(encoding="utf-8")
AXIS = load(PAPER).axes["x"]
STRANGE = "0123456789abcdef"

positive = st.floats(1e-6, 1e6)


def section(of_hash):
    """The section as it stands below an axis."""
    return f'    commissioned: {{hash: "{of_hash}", report: report.html, date: 2026-11-21}}\n'


def commissioned(of_hash):
    """The configuration with that section in axis x."""
    assert TEXT.count("  x:\n") == 1
    return TEXT.replace("  x:\n", "  x:\n" + section(of_hash))


def leaves(value, path=()):
    """Path of every single value in nested sections and lists."""
    if isinstance(value, dict):
        return [leaf for key, entry in value.items() for leaf in leaves(entry, (*path, key))]
    if isinstance(value, (list, tuple)):
        return [leaf for i, entry in enumerate(value) for leaf in leaves(entry, (*path, i))]
    return [path]


def changed(axis, path):
    """`axis` with another value at `path`, whether that is a good one or not."""
    first, *rest = path
    if isinstance(axis, tuple):
        return (*axis[:first], changed(axis[first], rest) if rest else other(axis[first]), *axis[first + 1 :])
    old = getattr(axis, first)
    return axis.model_copy(update={first: changed(old, rest) if rest else other(old)})


def other(value):
    if isinstance(value, str) or value is None:
        return f"not {value}"
    return value + 1 if isinstance(value, int) else value * (1 + 1e-8) + 1e-12


LIMITS = {"accept", "commissioned", "faults", "authority_percent"}
"""What no report is about."""


@pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")  # the other value need not be a good one
@pytest.mark.parametrize("path", leaves(AXIS.model_dump(exclude=LIMITS)), ids=lambda p: ".".join(map(str, p)))
def test_each_single_value_counts(path):
    assert tuning_hash(changed(AXIS, path)) != tuning_hash(AXIS)


def test_the_section_itself_does_not_count():
    noted = AXIS.model_copy(update={"commissioned": Commissioned(hash=STRANGE, report="a.html", date="2026-11-21")})
    assert tuning_hash(noted) == tuning_hash(AXIS)


def test_axes_with_the_same_tuning_have_the_same_hash_and_others_not():
    axes = load(PAPER).axes
    assert len({tuning_hash(axis) for axis in axes.values()}) == len(axes)
    assert len(tuning_hash(AXIS)) == 16
    assert set(tuning_hash(AXIS)) <= set("0123456789abcdef")


@given(positive, st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_the_last_bits_that_no_file_keeps_do_not_count(gain, time_ms, centre_um):
    def axis(jitter):
        inner = Inner(mode="pid", K_V_per_um=gain * jitter, Ti_ms=time_ms, Td_ms=0.0, filter_ms=time_ms)
        return Axis(mode="strain", centre_um=centre_um, setpoint=SetPoint(range_um=(-1e4, 1e4)), inner=inner)

    written = Axis.model_validate_json(
        json.dumps({**axis(1.0).model_dump(), "centre_um": float(f"{centre_um:.10g}") + 0.0})
    )
    assert tuning_hash(written) == tuning_hash(axis(1.0))
    assert tuning_hash(axis(1 + 1e-7)) != tuning_hash(axis(1.0))


def test_a_file_written_and_loaded_again_has_the_same_hash(tmp_path):
    configuration = load(PAPER)
    rng = np.random.default_rng(4)

    def disturbed(model):
        rows = {"A": tuple(tuple(v + rng.normal(0, 1e-3) for v in row) for row in model.A)}
        return model.model_copy(update=rows | {"B": tuple(v * rng.normal() for v in model.B)})

    axes = {}
    for name, axis in configuration.axes.items():
        outer = axis.outer.model_copy(
            update={"model": disturbed(axis.outer.model), "control_weight": rng.uniform(1, 10)}
        )
        weights = tuple(weight * rng.uniform(0.9, 1.1) for weight in axis.hysteresis.weights)
        hysteresis = axis.hysteresis.model_copy(update={"weights": weights})
        axes[name] = axis.model_copy(update={"outer": outer, "hysteresis": hysteresis})
    file = tmp_path / "tuned.yaml"
    file.write_text(with_tuning(TEXT, axes), encoding="utf-8")
    again = load(file)
    for name, axis in axes.items():
        assert again.axes[name] != axis  # the file keeps fewer digits
        assert tuning_hash(again.axes[name]) == tuning_hash(axis)
        assert tuning_hash(axis) != tuning_hash(configuration.axes[name])


@pytest.mark.parametrize("arguments", [[], ["--json"]])
def test_check_warns_in_one_line_and_passes(tmp_path, capsys, arguments):
    file = tmp_path / "cell.yaml"
    file.write_text(commissioned(STRANGE), encoding="utf-8")
    main(["check", str(file), *arguments])
    said = capsys.readouterr()
    line = next(i for i, text in enumerate(file.read_text().splitlines(), 1) if "commissioned:" in text)
    sentence = (
        f"{file}:{line}: axes.x.commissioned: axis x was changed after it was commissioned (report report.html, "
        "2026-11-21): commission it again, or remove the section commissioned"
    )
    assert said.err == f"WARNING: {sentence}\n"
    if arguments:
        assert json.loads(said.out)["warnings"] == [sentence]
    else:
        assert "good" in said.out
