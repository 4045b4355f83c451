"""The command line as a whole: help, exit codes, one document with --json, and no traceback for anybody."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from micromanip.cli.commands import SECTIONS
from micromanip.client import default_socket
from tests.further import further

from .command import COMMANDS, code_of

CONFIG = str(Path(__file__).parents[2] / "config" / "paper.yaml")
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
    f"run {CONFIG} --durtion 3",
    f"run {CONFIG} --duration -1",
    "completion",
    "get --watch",
    f"analyse margins {CONFIG}",
    f"analyse margins {CONFIG} --out out --samples -1",
    f"analyse margins {CONFIG} --out out --jobs 0",
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
    assert code_of("check", CONFIG) == 0
    out = capsys.readouterr().out
    assert ": good" in out
    assert "arms by itself as soon as READY, or within 30 s of it" in out
    assert code_of("check", CONFIG, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is True
    assert report["rate_hz"] == 10_000
    assert 0 < report["cycle_us"]
    assert report["arm_on_start"] == {"within_s": 30.0}
    assert set(report["axes"]) == {"x", "y", "z"}


def test_a_bad_configuration_is_78_and_one_line(tmp_path, capsys):
    file = tmp_path / "bad.yaml"
    file.write_text(Path(CONFIG).read_text(encoding="utf-8").replace("K_V_per_um: 0.6", "K_V_per_mm: 600", 1))
    assert code_of("run", str(file)) == 78
    (line,) = capsys.readouterr().err.strip().splitlines()
    number = next(n for n, text in enumerate(file.read_text().splitlines(), 1) if "K_V_per_mm" in text)
    assert line.startswith(f"micromanip: {file}:{number}: axes.x.inner.K_V_per_mm: ")
    assert "K_V_per_um" in line


NO_AXIS = ["identify", "commission", "analyse margins", "evaluate", "analyse path path.csv --config", "analyse error"]


@pytest.mark.parametrize("typed", NO_AXIS)
def test_an_axis_that_is_not_there_is_64_and_leaves_nothing(typed, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert code_of(*typed.split(), CONFIG, "--axis", "w", "--out", "out") == 64
    assert f"there is no axis w in {CONFIG}; its axes are x, y, z" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_we_did_not_foresee_is_70_with_a_file_and_no_traceback(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("micromanip.settings.check.prepare", lambda *_: 1 // 0)
    assert code_of("check", CONFIG, "--json") == 70
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
    f"check {CONFIG} --json --jsno": 64,
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
    "arguments", [*further(f"check {CONFIG}", f"check {CONFIG} --json"), "device list --json", "--help", "get --help"]
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
