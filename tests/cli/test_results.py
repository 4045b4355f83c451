"""Where results go: tried before anything moves, nothing older replaced, and a full disk loses as little as it can."""

import errno
import os
import re
import stat
from pathlib import Path

import pytest

from campaigns.report import CONFIG
from micromanip.cli.results import page_in, publish, run_folder
from micromanip.design.report.model import Section
from micromanip.errors import DeviceUnavailable, PermissionDenied, UsageError, system_error

from .command import code_of

FACTORY, SIMULATED = CONFIG / "factory.yaml", CONFIG / "simulated.yaml"


def files_in(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


WRITERS = {
    "identify": ("identify", FACTORY, "--axis", "x", "--seconds", "1"),
    "commission": ("commission", FACTORY, "--axis", "x"),
    "analyse": ("analyse", "margins", SIMULATED, "--axis", "x", "--samples", "0"),
    "evaluate": ("evaluate", SIMULATED, "--axis", "x"),
}


@pytest.mark.parametrize("command", WRITERS)
@pytest.mark.parametrize(
    ("place", "code"), [("/proc/micromanip/out", 64), ("/dev/null/out", 64), ("/sys/micromanip", 77)]
)
def test_a_place_that_takes_nothing_is_refused_before_the_work(command, place, code, monkeypatch, capsys):
    """Not even root makes a folder there. Nothing was moved, in virtual time or else, and nothing computed."""

    def moved(*_):
        raise AssertionError("it moved")

    monkeypatch.setattr("micromanip.virtual.experiment.VirtualExperiment.__call__", moved)
    assert code_of(*WRITERS[command], "--out", place) == code
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"micromanip: --out {place}: ")
    assert "bug" not in line


def test_identify_replaces_no_recording(tmp_path, capsys):
    assert code_of(*WRITERS["identify"], "--out", tmp_path) == 0
    before = files_in(tmp_path)
    assert code_of(*WRITERS["identify"], "--seed", "2", "--out", tmp_path) == 64
    assert f"{tmp_path / 'x_multisine.csv'} is there already" in capsys.readouterr().err
    assert files_in(tmp_path) == before
    assert code_of(*WRITERS["identify"], "--kind", "step", "--out", tmp_path) == 0


def run_of(folder, **contents):
    """A run that wrote `contents` (file by stem), published."""
    with run_folder(folder, "x", wanted="tuned.yaml") as run:
        for stem, text in contents.items():
            (run / f"{stem}.yaml").write_text(text)
        publish(folder, run, ("previous.yaml", "report.yaml", "tuned.yaml"))
    return run


def test_runs_are_kept_each_in_a_folder_of_its_own(tmp_path):
    runs = [run_of(tmp_path, tuned=f"tuning {k}", previous="before") for k in range(3)]
    assert len(set(runs)) == 3
    assert [(run / "tuned.yaml").read_text() for run in runs] == ["tuning 0", "tuning 1", "tuning 2"]
    assert (tmp_path / "latest" / "tuned.yaml").read_text() == "tuning 2"
    assert (tmp_path / "tuned.yaml").read_text() == "tuning 2"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == sorted(
        ["tuned.yaml", "previous.yaml", "latest", *(run.name for run in runs)]
    )
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE((tmp_path / "tuned.yaml").stat().st_mode) == 0o666 & ~umask


def test_what_somebody_changed_is_set_aside(tmp_path):
    """`save` into it, an editor, or an older version of the program: no run's folder has it."""
    (tmp_path / "tuned.yaml").write_text("of an older version")
    (tmp_path / "report.yaml").write_text("of an older version, too")
    os.utime(tmp_path / "tuned.yaml", (1e9, 1e9))
    os.utime(tmp_path / "report.yaml", (1e9, 1e9))
    run_of(tmp_path, tuned="first")
    aside = tmp_path / "2001-09-09T014640Z-earlier"
    assert files_in(aside) == {"tuned.yaml": b"of an older version", "report.yaml": b"of an older version, too"}
    assert not (tmp_path / "report.yaml").exists()  # the run has none: the older one is not about it
    (tmp_path / "tuned.yaml").write_text("edited")
    run_of(tmp_path, tuned="second")
    assert b"edited" in files_in(tmp_path).values()
    assert (tmp_path / "tuned.yaml").read_text() == "second"


def test_a_disk_that_fills_while_drawing_keeps_the_results(tmp_path, monkeypatch):
    """They are the command's to print first; of the page nothing is left, and what was there stays."""
    with page_in(tmp_path / "out", "fit.html") as page:
        page.write("first", [Section("Loop", "text")])
        whole = page.file.read_text()
        assert "<h2>Loop</h2>" in whole
        monkeypatch.setattr(Path, "replace", full)
        page.write("second", [Section("Loop", "text")])
        assert page.name is None
        page.write("third", [])
    assert isinstance(page.problem, DeviceUnavailable)
    assert re.match("the page is not written: .*fit.html: No space left on device", str(page.problem))
    assert files_in(tmp_path) == {"out/fit.html": whole.encode()}


def full(*_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_folder_without_room_is_refused_before_anything_moves(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(os, "posix_fallocate", full)
    assert code_of(*WRITERS["identify"], "--out", tmp_path / "out") == 69
    assert f"--out {tmp_path / 'out'}: No space left on device; make room there" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (errno.EACCES, PermissionDenied),
        (errno.ENOENT, UsageError),
        (errno.ENOSPC, DeviceUnavailable),
        (errno.EIO, DeviceUnavailable),
    ],
)
def test_what_the_system_refuses_is_no_bug(number, kind, monkeypatch, capsys):
    problem = OSError(number, os.strerror(number), "/some/file")
    assert type(system_error(problem)) is kind

    def refused(*_):
        raise problem

    monkeypatch.setattr("micromanip.settings.check.prepare", refused)
    assert code_of("check", FACTORY) == kind.exit_code
    said = capsys.readouterr().err
    assert said.startswith(f"micromanip: /some/file: {os.strerror(number)}")
    assert len(said.splitlines()) == 1
