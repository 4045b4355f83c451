"""The command line as a whole: help, exit codes, and no traceback for anybody."""

import json
import subprocess
import sys
from pathlib import Path

import click
import pytest

from micromanip.cli.main import COMMANDS, GROUPS, cli
from micromanip.cli.options import print_json
from micromanip.client import default_socket
from micromanip.errors import CheckFailed
from tests.further import further

from .command import code_of

CONFIG = str(Path(__file__).parents[2] / "config" / "paper.yaml")
FULL = "standard output: No space left on device; make room there, or choose another place\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_shows_an_example(name, capsys):
    assert code_of(name, "--help") == 0
    shown = capsys.readouterr().out
    if name == "fit":
        assert code_of("fit", "linear", "--help") == 0
        assert "Example: " in capsys.readouterr().out
        assert code_of("fit", "hysteresis", "--help") == 0
        shown = capsys.readouterr().out
    assert "Example: " in shown


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_found_by_its_name(name):
    assert cli.get_command(click.Context(cli), name).name == name


@pytest.mark.parametrize(
    "arguments",
    [["chekc"], ["run"], ["run", CONFIG, "--durtion", "3"], ["run", CONFIG, "--duration", "-1"], ["completion"]],
)
def test_wrong_usage_is_64(arguments, capsys):
    assert code_of(*arguments) == 64
    assert "Error: " in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["status", "arm", "disarm", "reset"])
def test_no_controller_is_69_and_says_the_next_step(verb, tmp_path, capsys):
    assert code_of(verb, "--socket", str(tmp_path / "none.sock")) == 69
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
    lines = capsys.readouterr().err.strip().splitlines()
    line = next(n for n, text in enumerate(file.read_text().splitlines(), 1) if "K_V_per_mm" in text)
    assert len(lines) == 1
    assert lines[0].startswith(f"micromanip: {file}:{line}: axes.x.inner.K_V_per_mm: ")
    assert "K_V_per_um" in lines[0]


def test_what_we_did_not_foresee_is_70_with_a_file_and_no_traceback(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)

    def broken(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("micromanip.settings.check.prepare", broken)
    assert code_of("check", CONFIG) == 70
    shown = capsys.readouterr().err
    assert "Traceback" not in shown
    assert "ZeroDivisionError: a bug" in shown
    trace = Path(shown.strip().split()[-1])
    assert "ZeroDivisionError" in trace.read_text()


def test_completion_scripts(capsys):
    for shell in ("bash", "zsh", "fish"):
        assert code_of("completion", shell) == 0
        assert "_MICROMANIP_COMPLETE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("typed", "meant"), [("stauts", "status"), ("comission", "commission"), ("probes", "probe"), ("simulate", None)]
)
def test_a_near_miss_gets_a_suggestion(typed, meant, capsys):
    assert code_of(typed) == 64
    said = capsys.readouterr().err
    assert f"did you mean {meant}?" in said if meant else "--help" in said


def test_help_of_run_says_from_when_its_duration_counts(capsys):
    assert code_of("run", "--help") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "so many seconds after READY; where arm_on_start arms, after that" in shown


def test_help_has_every_command_in_one_group(capsys):
    assert code_of("--help") == 0
    shown = capsys.readouterr().out
    assert [title for title in GROUPS if f"\n{title}:\n" in shown] == list(GROUPS)
    listed = [line.split()[0] for line in shown.splitlines() if line.startswith("  ") and line[2].isalpha()]
    assert [name for name in listed if name in COMMANDS] == list(COMMANDS)


def test_the_socket_s_default_is_the_real_one(monkeypatch, capsys):
    assert code_of("status", "--help") == 0
    assert str(default_socket()) in capsys.readouterr().out


ERRORS = {
    "usage": (("check", "--json"), 64),
    "command": (("stauts", "--json"), 64),
    "option": (("check", CONFIG, "--json", "--jsno"), 64),
    "file": (("check", "none.yaml", "--json"), 78),
    "controller": (("status", "--json", "--socket", "/nowhere/none.sock"), 69),
}


@pytest.mark.parametrize(("arguments", "code"), ERRORS.values(), ids=ERRORS)
def test_an_error_is_one_document_too_where_json_is_asked_for(arguments, code, capsys):
    assert code_of(*arguments) == code
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["exit_code"] == code
    assert document["error"] in err


def test_a_bug_is_one_document_too(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("micromanip.settings.check.prepare", lambda *_: 1 // 0)
    assert code_of("check", CONFIG, "--json") == 70
    assert json.loads(capsys.readouterr().out)["error"].startswith("bug: ZeroDivisionError: ")


def test_what_fails_after_its_document_adds_none(monkeypatch, capsys):
    """`evaluate` prints its document, and then says that a figure could not be written."""

    @click.command("check")
    def checked():
        print_json({"good": False})
        raise CheckFailed("no")

    monkeypatch.setattr(type(cli), "get_command", lambda self, ctx, name: checked)
    checked.params.append(click.Option(["--json", "as_json"], is_flag=True, expose_value=False))
    assert code_of("check", "--json") == 1
    assert json.loads(capsys.readouterr().out) == {"good": False}


@pytest.mark.parametrize(
    "arguments",
    [
        *further((("check", CONFIG),), (("check", CONFIG, "--json"),)),
        ("drivers", "--json"),
        ("--help",),
        ("get", "--help"),
    ],
)
@pytest.mark.parametrize(
    ("redirected", "code", "said"),
    [("| head -c 1", 0, ""), (">&-", 0, ""), ("> /dev/full", 69, FULL)],
)
def test_a_closed_or_full_output_is_no_bug(arguments, redirected, code, said, tmp_path):
    command = " ".join([str(Path(sys.executable).with_name("micromanip")), *arguments])
    done = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command} {redirected}"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, said in done.stderr) == (code, True), done.stderr
    assert "bug" not in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
