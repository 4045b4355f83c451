"""Mistakes that only show when sections are seen together: one line each, with the place and the way out."""

from pathlib import Path

import pytest

from micromanip.errors import ConfigError
from micromanip.io.contract import CyclicDriver
from micromanip.io.registry import driver_class
from micromanip.settings import wiring
from micromanip.settings.check import prepare

CONFIG = Path(__file__).parents[2] / "config" / "simulated.yaml"
TEXT = CONFIG.read_text(encoding="utf-8")


def line_of(text, marker):
    """Number of the first line that contains `marker`."""
    return next(number for number, line in enumerate(text.splitlines(), 1) if marker in line)


def complaint(tmp_path, text):
    """What `prepare` says about a configuration, without the file's name."""
    file = tmp_path / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        prepare(file)
    return str(refused.value).replace(f"{file}:", "")


BROKEN = {
    "unknown driver": (
        ("  strain_x: {driver: cell, max", "  strain_x: {driver: sell, max"),
        "strain_x: {",
        "signals.strain_x.driver: there is no driver sell; the section drivers has cell",
    ),
    "driver not installed": (
        ("driver: simulated\n    seed", "driver: simulatd\n    seed"),
        "driver: simulatd",
        "drivers.cell.driver: no driver called simulatd is installed; did you mean simulated?",
    ),
    "driver's own key": (
        ("    seed: 1\n", "    sead: 1\n"),
        "sead: 1",
        "drivers.cell.sead: unknown key sead: did you mean seed?",
    ),
    "unknown channel": (
        ("stage_x: {driver: cell, max", "stage_x: {driver: cell, channel: stag_x, max"),
        "stage_x: {",
        "signals.stage_x: driver cell has no channel stag_x; did you mean stage_x?",
    ),
    "signal that nobody takes": (
        ("  strain_x: {driver: cell, max", "  strian_x: {driver: cell, channel: strain_x, max"),
        "strian_x: {",
        "signals.strian_x: no axis takes a signal of this name; did you mean strain_x? (names are <role>_<axis>)",
    ),
    "output that nobody has": (
        ("  voltage_z: {driver: cell,", "  voltage_w: {driver: cell, channel: voltage_z,"),
        "voltage_w: {",
        "outputs.voltage_w: no axis has this output; outputs are named voltage_<axis> (x, y, z)",
    ),
    "two outputs on a channel": (
        ("  voltage_z: {driver: cell,", "  voltage_z: {driver: cell, channel: voltage_y,"),
        "voltage_z: {",
        "outputs.voltage_z: another output writes the same channel already",
    ),
    "reference out of reach": (
        ("  noise_um: 0.5\n\naxes:", "  noise_um: 0.5\n  range_um: [-400, 300]\n\naxes:"),
        "reference:",
        "reference: axis x can't reach it: the reference asks for",
    ),
    "set-point beyond the model": (
        ("    setpoint: {range_um: [2, 128]", "    setpoint: {range_um: [-5, 128]"),
        "range_um: [-5, 128]",
        "axes.x.setpoint.range_um: [-5.0, 128.0] um goes beyond the hysteresis model's range_um [2.0, 128.0]",
    ),
    "spin longer than the period": (
        ("spin_us: 60 ", "spin_us: 100 "),
        "spin_us: 100",
        "loop.spin_us: must be shorter than the period of 100 us",
    ),
    "file that is not there": (
        (TEXT[TEXT.index("  source: signal") : TEXT.index("\naxes:")], "  source: file\n  path: nowhere.csv\n"),
        "path: nowhere.csv",
        "reference.path: nowhere.csv can't be read as a CSV of numbers with a header:",
    ),
    "variation of no axis": (
        ("      y: {preisach", "      w: {preisach"),
        "  cell:",
        "drivers.cell: variation.w: there is no axis w; axes are x, y, z",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_one_line_with_place_and_way_out(tmp_path, name):
    (old, new), marker, message = BROKEN[name]
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    lines = complaint(tmp_path, text).splitlines()
    assert lines[0].startswith(f"{line_of(text, marker)}: {message}")


def test_a_missing_signal_is_asked_for(tmp_path):
    text = "\n".join(line for line in TEXT.splitlines() if not line.startswith("  stage_y:"))
    expected = "axes.y: mode stage needs the signal stage_y, which the section signals does not have"
    axes = text[text.index("\naxes:") :]
    offset = text[: text.index("\naxes:")].count("\n")
    assert complaint(tmp_path, text) == f"{offset + line_of(axes, '  y:')}: {expected}"


def test_an_unstable_outer_loop_is_refused(tmp_path):
    row = next(line for line in TEXT.splitlines() if line.strip().startswith("- [0.0, 0.0, 0.9"))
    number = row.split("[0.0, 0.0, ")[1].split(",")[0]
    gains = next(line for line in TEXT.splitlines() if line.strip().startswith("B: ["))
    third = gains.split(", ")[2]
    # an unstable mode that the set-point does not reach: no feedback helps
    text = TEXT.replace(number, "1.002", 1).replace(gains, gains.replace(third, "0.0"), 1)
    said = complaint(tmp_path, text)
    assert "axes.x.outer: " in said
    assert "unstable" in said or "no stabilising gains" in said


class RealStage(CyclicDriver):
    """Hardware as far as the rules are concerned."""

    Options = driver_class("simulated").Options
    simulated = False

    def __init__(self, options, period_ns):
        self.twin = driver_class("simulated")(options, period_ns)

    inputs = property(lambda self: self.twin.inputs)
    outputs = property(lambda self: self.twin.outputs)

    def context(self):
        raise AssertionError("a check must not touch the hardware")

    functions = context


def test_hardware_does_not_arm_itself_and_needs_hardware_limits_and_a_watchdog(tmp_path, monkeypatch):
    monkeypatch.setattr(wiring, "driver_class", lambda _: RealStage)
    lines = complaint(tmp_path, TEXT).splitlines()
    assert len(lines) == 3
    assert (
        f"{line_of(TEXT, 'limits: simulation')}: loop.limits: driver cell moves a real stage: limits must be hardware"
        in lines
    )
    assert any("without_watchdog: true" in line for line in lines)
    assert any(
        ": arm_on_start: only a simulation may arm by itself; driver cell moves a real stage" in line for line in lines
    )
    good = TEXT.replace("limits: simulation", "limits: hardware").replace("arm_on_start: true", "arm_on_start: false")
    file = tmp_path / "good.yaml"
    file.write_text(good.replace("    seed: 1\n", "    seed: 1\n    without_watchdog: true\n"), encoding="utf-8")
    assert not prepare(file).configuration.arm_on_start
