"""Mistakes that only show when sections are seen together: one line each, with the place and the way out."""

import json
import os
from pathlib import Path

import pytest

from campaigns.report import CONFIG
from micromanip.bus.cyclic import CyclicDriver
from micromanip.bus.registry import driver_class
from micromanip.cli.main import main
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare, refuse_real
from micromanip.settings.checks.ranges import range_findings
from micromanip.settings.schema.reference import Sine, Sines
from micromanip.settings.wiring import places as wiring

PAPER = CONFIG / "paper.yaml"
TEXT = PAPER.read_text(encoding="utf-8")


def _swinging(*each):
    """Lines of `reference.axes` with oscillations of (Hz, range_percent)."""
    lines = [
        f"        - {{frequency_Hz: {hertz}, um_per_s: 200.0, range_percent: {percent}}}\n" for hertz, percent in each
    ]
    return "".join(["  axes:\n    x:\n      oscillations:\n", *lines])


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
    "sweep that throws the stage about": (
        ("  lift_s: 0.5", "  sweep_s: 0.1\n  lift_s: 0.5"),
        "  sweep_s: 0.1",
        "start.sweep_s: 5 turns in 0.1 s, 50 Hz, would swing the stage on its flexure; at most 20 Hz: 0.25 or more, or "
        "0 for no sweep",
    ),
    "unknown channel": (
        ("stage_x: {driver: cell, max", "stage_x: {driver: cell, channel: stag_x, max"),
        "stage_x: {",
        "signals.stage_x: driver cell has no channel stag_x; did you mean stage_x?",
    ),
    "signal that nobody takes": (
        ("  strain_x: {driver: cell, max", "  strian_x: {driver: cell, channel: strain_x, max"),
        "strian_x: {",
        "signals.strian_x: no axis takes a signal of this name; did you mean strain_x? (names are <role>_<axis>, "
        "enable, interlock, retracted, part, tool, temperature)",
    ),
    "joints that could be taken for each other": (
        ("  noise_um: 0.5\n\naxes:", f"  noise_um: 0.5\n{_swinging((8.0, 30.0), (10.0, 30.0))}\naxes:"),
        "      oscillations:",
        "reference.axes.x.oscillations: oscillations at 8 and 10 Hz could find the same frequency: their range_percent",
    ),
    "joints that a slow tracker can't follow so far": (
        (
            "  sample_rate_Hz: 1000\n  oscillation_Hz: 8       # the robot's joints\n  noise_um: 0.5\n",
            "  sample_rate_Hz: 200\n  jerk_um_per_s3: 1.0e+5\n  noise_um: 0.5\n" + _swinging((8.3, 60.0), (52.0, 60.0)),
        ),
        "      oscillations:",
        "reference.axes.x.oscillations: in their ranges the predictor would be unstable: a pole at radius ",
    ),
    "a narrow predictor that a slow tracker does not bear": (
        (
            "  sample_rate_Hz: 1000\n  oscillation_Hz: 8       # the robot's joints\n  noise_um: 0.5\n",
            "  sample_rate_Hz: 100\n  jerk_um_per_s3: 9.5e+5\n  noise_um: 0.5\n"
            + _swinging((4.78, 53.0), (13.1, 53.0)).replace("200.0", "34.0", 1).replace("200.0", "10.8")
            + "      steady: {jerk_um_per_s3: 1.8e+4}\n",
        ),
        "      steady:",
        "reference.axes.x.steady: in the oscillations' ranges the narrow predictor would be unstable: a pole at ",
    ),
    "a path that returns as fast as a joint swings": (
        (
            "  noise_um: 0.5\n\naxes:",
            f"  noise_um: 0.5\n{_swinging((8.0, 30.0))}      steady: {{returns_Hz: 6.5}}\n\naxes:",
        ),
        "      steady:",
        "reference.axes.x.steady.returns_Hz: steady.returns_Hz 6.5 must be less than the lowest frequency of an ",
    ),
    "learning of what follows no tracker": (
        (
            TEXT[TEXT.index("  source: signal") : TEXT.index("\naxes:")],
            "  source: hold\n  offset_um: 0\n\nlearning: {seconds: 3.0}\n",
        ),
        "learning: {",
        "learning: only what follows a tracker learns: reference.source is hold, it must be signal",
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
}


@pytest.mark.parametrize("name", BROKEN)
def test_one_line_with_place_and_way_out(tmp_path, name):
    (old, new), marker, message = BROKEN[name]
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    lines = complaint(tmp_path, text).splitlines()
    assert lines[0].startswith(f"{line_of(text, marker)}: {message}")


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


CELL = Path(__file__).with_name("cell.yaml").read_text(encoding="utf-8").replace("offset_um: 0", "offset_um: 65")

WHOLE = {
    "stage mode without outer loop": (
        ("mode: strain", "mode: stage"),
        "mode: stage",
        "axes.x.mode: mode stage needs the section outer; mode strain does without",
    ),
    "out of the actuator's reach": (
        ("offset_um: 65", "offset_um: 110"),
        "reference:",
        "reference: axis x can't reach it: the reference asks for 80..140 um of the actuator, its range is 5..125 um",
    ),
    "missing output": (
        ("  voltage_x:", "  voltage_y:"),
        None,
        [
            ("  voltage_y:", "outputs.voltage_y: no axis has this output; outputs are named voltage_<axis> (x)"),
            ("  x:", "axes.x: there is no output voltage_x; add it to the section outputs"),
        ],
    ),
    "CPU that hardware limits can't have": (
        ("  cpu: 1\n  limits: simulation", "  cpu: 4096\n  limits: hardware"),
        "cpu: 4096",
        f"loop.cpu: this machine has the CPUs 0 to {(os.cpu_count() or 1) - 1}",
    ),
    "value that only the driver knows": (
        ("seed: 1}", "seed: 1, coupling: 0.5}"),
        "coupling",
        "drivers.cell.coupling: expected a number from 0 to 0.1, not 0.5",
    ),
}


@pytest.mark.parametrize("name", WHOLE)
def test_the_whole_message(tmp_path, name):
    (old, new), marker, expected = WHOLE[name]
    assert CELL.count(old) == 1
    text = CELL.replace(old, new)
    findings = expected if marker is None else [(marker, expected)]
    assert complaint(tmp_path, text).splitlines() == [
        f"{line_of(text, marker)}: {sentence}" for marker, sentence in findings
    ]


@pytest.mark.parametrize(("sign", "asked"), [(1, "102.3..122.4"), (-1, "9.567..29.72")])
def test_a_stage_that_goes_against_its_actuator_reaches_the_other_end(sign, asked):
    """With a negative steady gain the reference's highest value is the lowest set-point."""
    configuration = prepare(PAPER).configuration
    x = configuration.axes["x"]
    outer = x.outer.model_copy(
        update={"model": x.outer.model.model_copy(update={"C": [sign * c for c in x.outer.model.C]})}
    )
    setpoint = x.setpoint.model_copy(update={"range_um": (x.centre_um - 40.0, x.centre_um + 40.0)})
    axes = {"x": x.model_copy(update={"outer": outer, "setpoint": setpoint})}

    def found(offset_um):
        reference = Sines(source="sine", offset_um=offset_um, sines=[Sine(amplitude_um=50.0, frequency_Hz=1.0)])
        return [
            text for _, text in range_findings(configuration.model_copy(update={"axes": axes, "reference": reference}))
        ]

    assert found(0.0) == []
    (refusal,) = found(230.0)
    assert f"asks for {asked} um of the actuator" in refusal


def test_a_voltage_out_of_range_and_one_that_should_follow_a_signal(tmp_path):
    text = CELL.replace("mode: strain", "mode: voltage").replace("offset_um: 65", "offset_um: 125")
    assert complaint(tmp_path, text) == (
        f"{line_of(text, 'reference:')}: reference: axis x can't reach it: the reference asks for 95..155 V "
        "of the actuator, its range is -20..150 V"
    )
    sines = CELL[CELL.index("  source: sine") : CELL.index("axes:")]
    text = CELL.replace(sines, "  source: signal\n").replace("mode: strain", "mode: voltage")
    assert complaint(tmp_path, text).splitlines()[-1] == (
        f"{line_of(text, 'mode: voltage')}: axes.x.mode: a voltage can't follow the source signal; "
        "use mode strain or stage"
    )


CSV = {
    "missing": (None, "wave.csv can't be read as a CSV of numbers with a header: "),
    "words": ("x\n1.0\nhello\n", "wave.csv can't be read as a CSV of numbers with a header: "),
    "other column": ("t,y\n0,1\n1,2\n", "wave.csv has no column x; its columns are t, y"),
    "not finite": ("x\n65.0\nnan\n", "wave.csv needs at least two rows of finite numbers"),
}


def playing(tmp_path):
    """The cell with a file as its reference."""
    sines = CELL[CELL.index("  source: sine") : CELL.index("axes:")]
    return CELL.replace(sines, "  source: file\n  path: wave.csv\n  sample_rate_Hz: 1000\n")


@pytest.mark.parametrize("name", CSV)
def test_a_waveform_that_cannot_be_played(tmp_path, name):
    content, message = CSV[name]
    if content is not None:
        (tmp_path / "wave.csv").write_text(content, encoding="utf-8")
    text = playing(tmp_path)
    lines = complaint(tmp_path, text).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"{line_of(text, 'path: wave.csv')}: reference.path: {message}")


def test_a_waveform_is_brought_to_the_loops_rate(tmp_path):
    (tmp_path / "wave.csv").write_text("t,x\n0,60.0\n1,70.0\n2,65.0\n", encoding="utf-8")
    file = tmp_path / "cell.yaml"
    file.write_text(playing(tmp_path), encoding="utf-8")
    samples = prepare(file).samples[:, 0]
    assert list(samples[::10]) == [60.0, 70.0, 65.0]
    assert list(samples[:4]) == pytest.approx([60.0, 61.0, 62.0, 63.0])


def test_a_broken_configuration_starts_nothing(tmp_path, monkeypatch, capsys):
    """78, and neither a socket nor a process that is given orders: the loop's, which has begun to import, is ended."""

    def ordered(*_, **__):
        raise AssertionError("something was given orders")

    monkeypatch.setattr("micromanip.host.child.send_orders", ordered)
    file = tmp_path / "cell.yaml"
    file.write_text(CELL.replace("offset_um: 65", "offset_um: 110"), encoding="utf-8")
    for command in (["run", "--socket", str(tmp_path / "s")], ["check"], ["check", "--json"], ["evaluate"]):
        with pytest.raises(SystemExit) as ended:
            main([*command, str(file)])
        assert ended.value.code == 78
        shown = capsys.readouterr()
        assert (json.loads(shown.out)["exit_code"] == 78) if "--json" in command else (shown.out == "")
        assert shown.err.startswith(f"micromanip: {file}:{line_of(CELL, 'reference:')}: reference: axis x can't reach")
    assert [entry.name for entry in tmp_path.iterdir()] == ["cell.yaml"]
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    assert not any(b"loop_process" in Path(f"/proc/{child}/cmdline").read_bytes() for child in children)


def test_a_range_that_the_tanh_cannot_reach(tmp_path):
    text = TEXT.replace("[180.3023655, ", "[60.3023655, ")
    line = line_of(text, "    hysteresis:") + 1
    said = complaint(tmp_path, text)
    assert said.startswith(
        f"{line}: axes.x.hysteresis.range_um: [2.0, 128.0] um is more than the tanh shaping can reach: "
    )


def test_what_was_not_there_yet_is_judged_once_it_is(tmp_path):
    board = tmp_path / "board"
    file = tmp_path / "cell.yaml"
    text = (PAPER.parent / "serial.yaml").read_text(encoding="utf-8")
    file.write_text(text.replace("/tmp/micromanip-board", str(board)), encoding="utf-8")
    prepared = prepare(file)
    refuse_real(prepared)
    board.symlink_to("/dev/null")
    with pytest.raises(
        ConfigError, match=rf"cell.yaml:\d+: drivers.board.simulated: {board} \(/dev/null\) is no pseudo"
    ):
        refuse_real(prepared)
