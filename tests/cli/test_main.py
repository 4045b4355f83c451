"""The command line as a whole: help, exit codes, one document with --json, and no traceback for anybody."""

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import click
import pytest

from campaigns.report import CONFIG
from micromanip.cli.commands import SECTIONS
from micromanip.cli.options import Quantity
from micromanip.client import default_socket
from tests.cli.command import COMMANDS, code_of
from tests.further import further

ONCE = [
    (name, option) for name, command in COMMANDS.items() for option in command.params
    if isinstance(option, click.Option) and not option.multiple
]  # fmt: skip
NUMBERS = [
    (name, each) for name, command in COMMANDS.items() for each in command.params if isinstance(each.type, Quantity)
]


def refusal(capsys, *arguments):
    assert code_of(*arguments) == 64
    return capsys.readouterr().err


@pytest.mark.parametrize(("name", "option"), ONCE, ids=lambda each: getattr(each, "name", each))
def test_an_option_given_twice_is_named(name, option, capsys):
    text = [option.opts[0]] if option.is_flag else [option.opts[0], "1"]
    assert f"{'/'.join(option.opts)} is given more than once" in refusal(capsys, *name.split(), *text, *text)


def test_an_axis_given_twice_moves_none(tmp_path, capsys):
    message = refusal(capsys, "identify", "none.yaml", "--axis", "x", "--axis", "y", "--out", str(tmp_path / "out"))
    assert "--axis is given more than once" in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_number_has_bounds(name):
    for each in COMMANDS[name].params:
        assert not isinstance(each.type, click.types.FloatParamType), each.name  # of a range also: it takes NaN
        if isinstance(each.type, click.types.IntParamType):
            assert None not in (getattr(each.type, "min", None), getattr(each.type, "max", None)), each.name


@pytest.mark.parametrize("text", ["nan", "-inf", "1e300", "fast", ""])
@pytest.mark.parametrize(("name", "number"), NUMBERS, ids=lambda each: getattr(each, "name", each))
def test_no_number_that_none_could_mean(name, number, text, capsys):
    given = [f"{number.opts[0]}={text}"] if isinstance(number, click.Option) else ["--", "x", text]
    needed = [each for each in COMMANDS[name].params if isinstance(each, click.Argument) and each.required]
    before = [] if given[0] == "--" else ["x"] * len(needed)
    message = refusal(capsys, *name.split(), *given, *before)
    assert " number from " in message


FIT = ("--input", "u", "--output", "y", "--burn-in", "0")


@pytest.mark.parametrize(
    ("missing", "extra", "arguments"),
    [
        ("h5py", "formats", ("fit", "hysteresis", "foreign.h5", *FIT)),
        ("h5py", "formats", ("fit", "hysteresis", "new.mat", *FIT)),
        ("pyarrow", "formats", ("fit", "hysteresis", "foreign.parquet", *FIT)),
        ("uvicorn", "gateway", ("gateway", "cell.yaml")),
    ],
)
def test_a_command_names_the_extra(missing, extra, arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "foreign.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    (tmp_path / "foreign.parquet").write_bytes(b"PAR1PAR1")
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n")
    monkeypatch.setitem(sys.modules, missing, None)
    for name in [name for name in sys.modules if name.startswith("micromanip.gateway")]:
        monkeypatch.delitem(sys.modules, name)
    assert code_of(*arguments) == 69
    said = capsys.readouterr().err
    assert f"needs {missing}: install micromanip with its extra {extra} " in said


@pytest.fixture(params=["pipe", "device", "socket", "folder"])
def no_file(request, tmp_path, monkeypatch):
    """Something of that kind, under a short name: a socket's is limited."""
    monkeypatch.chdir(tmp_path)
    file = Path("input")
    if request.param == "pipe":
        os.mkfifo(file)
    elif request.param == "device":
        file.symlink_to("/dev/zero")
    elif request.param == "folder":
        file.mkdir()
    else:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(str(file))
    return file


@pytest.mark.parametrize("command", ["check", "run", "device simulate", "park", "evaluate"])
def test_a_configuration(command, no_file, capsys):
    assert code_of(*command.split(), no_file) == 78
    assert re.search("not a regular file|a directory", capsys.readouterr().err)


@pytest.mark.parametrize("kind", ["hysteresis", "linear"])
def test_a_recording(kind, no_file, capsys):
    file = no_file.rename("recording")
    assert code_of("fit", kind, file, "--input", "u", "--output", "y") == 1
    assert re.search("not a regular file|Is a directory", capsys.readouterr().err)


PAPER = str(CONFIG / "paper.yaml")
FULL = "standard output: No space left on device; make room there, or choose another place\n"


def test_help_is_one_screen_and_has_every_command_once(capsys):
    assert code_of("--help") == 0
    lines = capsys.readouterr().out.splitlines()
    assert 24 <= len(lines) <= 40
    assert max(map(len, lines)) <= 80
    listed = [line.split()[0] for line in lines if line.startswith("  ")]
    assert listed == [name for section in SECTIONS.values() for name in section]
    assert set(listed) == {name.split()[0] for name in COMMANDS}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_shows_an_example_and_takes_json(name, capsys):
    assert code_of(*name.split(), "--help") == 0
    shown = capsys.readouterr().out
    assert "Example: " in shown
    assert f"micromanip {name}" in " ".join(shown.partition("Example: ")[2].split())
    assert "--json" in shown


NEAR = {"stauts": "status", "comission": "commission", "recording strat": "start", "fit hysterisis": "hysteresis"}
USAGE = [
    "chekc",
    "run",
    f"run {PAPER} --durtion 3",
    f"run {PAPER} --duration -1",
    "completion",
    "get --watch",
    f"analyse margins {PAPER} --out out --samples -1",
    f"analyse margins {PAPER} --out out --jobs 0",
]


@pytest.mark.parametrize("typed", [*NEAR, *USAGE])
def test_wrong_usage_is_64_and_a_near_miss_gets_a_suggestion(typed, capsys):
    assert code_of(*typed.split()) == 64
    assert f"did you mean {NEAR[typed]}?" in capsys.readouterr().err if typed in NEAR else True


@pytest.mark.parametrize(
    "verb", ["status", "status --watch", "arm", "get --watch x.strain_um", "log", "learn part end"]
)
def test_no_controller_is_69_and_says_the_next_step(verb, tmp_path, capsys):
    assert code_of(*verb.split(), "--socket", tmp_path / "none.sock") == 69
    assert "micromanip run CONFIG" in capsys.readouterr().err


def test_a_good_configuration(capsys):
    assert code_of("check", PAPER) == 0
    out = capsys.readouterr().out
    assert ": good" in out
    assert "arms by itself as soon as READY, or within 30 s of it" in out
    assert code_of("check", PAPER, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is True
    assert report["rate_hz"] == 10_000
    assert 0 < report["cycle_us"]
    assert report["arm_on_start"] == {"within_s": 30.0}
    assert set(report["axes"]) == {"x", "y", "z"}


def test_a_bad_configuration_is_78_and_one_line(tmp_path, capsys):
    file = tmp_path / "bad.yaml"
    file.write_text(Path(PAPER).read_text(encoding="utf-8").replace("K_V_per_um: 0.6", "K_V_per_mm: 600", 1))
    assert code_of("run", str(file)) == 78
    (line,) = capsys.readouterr().err.strip().splitlines()
    number = next(n for n, text in enumerate(file.read_text().splitlines(), 1) if "K_V_per_mm" in text)
    assert line.startswith(f"micromanip: {file}:{number}: axes.x.inner.K_V_per_mm: ")
    assert "K_V_per_um" in line


NO_AXIS = ["identify", "commission", "analyse margins", "evaluate", "analyse path path.csv --config", "analyse error"]


@pytest.mark.parametrize("typed", NO_AXIS)
def test_an_axis_that_is_not_there_is_64_and_leaves_nothing(typed, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert code_of(*typed.split(), PAPER, "--axis", "w", "--out", "out") == 64
    assert f"there is no axis 'w' in {PAPER}; there are x, y, z" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_we_did_not_foresee_is_70_with_a_file_and_no_traceback(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("micromanip.settings.check.prepare", lambda *_: 1 // 0)
    assert code_of("check", PAPER, "--json") == 70
    out, err = capsys.readouterr()
    assert json.loads(out)["error"].startswith("bug: ZeroDivisionError: ")
    assert "Traceback" not in err
    assert "ZeroDivisionError" in Path(err.strip().split()[-1]).read_text()


def test_the_socket_s_default_is_the_real_one(capsys):
    assert code_of("status", "--help") == 0
    assert str(default_socket()) in capsys.readouterr().out


ERRORS = {
    "check --json": 64,
    "stauts --json": 64,
    f"check {PAPER} --json --jsno": 64,
    "check none.yaml --json": 78,
    "status --json --socket /nowhere/none.sock": 69,
}


@pytest.mark.parametrize("typed", ERRORS)
def test_an_error_is_one_document_too_where_json_is_asked_for(typed, capsys):
    assert code_of(*typed.split()) == ERRORS[typed]
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["exit_code"] == ERRORS[typed]
    assert document["error"] in err


@pytest.mark.parametrize(
    "arguments", [*further(f"check {PAPER}", f"check {PAPER} --json"), "device list --json", "--help", "get --help"]
)
@pytest.mark.parametrize(
    ("redirected", "code", "said"), [("| head -c 1", 0, ""), (">&-", 0, ""), ("> /dev/full", 69, FULL)]
)
def test_a_closed_or_full_output_is_no_bug(arguments, redirected, code, said):
    program = Path(sys.executable).with_name("micromanip")
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {program} {arguments} {redirected}"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, said in done.stderr) == (code, True), done.stderr
    for word in ("bug", "Traceback", "Exception ignored"):
        assert word not in done.stderr
