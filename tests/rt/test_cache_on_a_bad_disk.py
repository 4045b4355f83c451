"""The compile cache where the disk takes nothing: slower, said once, and never the end of a start; and what is told."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from micromanip.host.state_directory import state_directory
from micromanip.rt.jit import cache_root

pytestmark = [pytest.mark.compiled_only, pytest.mark.live]  # in processes of their own

PROGRAM = """\
import ctypes
from micromanip.rt.jit import Compiler

Compiler.tell = staticmethod(print)
compiler = Compiler(__file__)


@compiler
def doubled(x):
    return 2.0 * x


@compiler.entry("f8(f8)")
def step(x):
    return doubled(x) + 1.0


@compiler.c_function("f8(f8)")
def from_c(x):
    return step(x)


print(step(3.0), ctypes.CFUNCTYPE(*[ctypes.c_double] * 2)(from_c.address)(4.0), compiler.cache_dir)
"""


def run(folder, *, limit=None, **environment):
    """The program's standard error, its cache folder while it ran, what it told that it compiles.

    `limit` is of a file's size.
    """
    program = folder / "package" / "program.py"
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(PROGRAM)
    begin = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit})); " if limit else ""
    done = subprocess.run(
        [sys.executable, "-c", f"{begin}import runpy; runpy.run_path({str(program)!r})"],
        env=os.environ | environment,
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    *told, step, from_c, cache = done.stdout.split()
    assert (float(step), float(from_c)) == (7.0, 9.0)
    return done.stderr, Path(cache), told


def test_a_home_that_takes_nothing(tmp_path):
    """As root, too: below a file there is no folder."""
    (tmp_path / "file").touch()
    said, cache, _ = run(tmp_path, XDG_CACHE_HOME=str(tmp_path / "file" / "cache"))
    assert said.startswith(f"WARNING: compiled code can't be kept in {tmp_path}/file/cache/micromanip: ")
    assert len(said.splitlines()) == 1
    assert not cache.exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can play another user")
def test_code_that_a_stranger_may_have_put_there_is_not_loaded(tmp_path):
    there = tmp_path / "cache" / "micromanip"
    there.mkdir(parents=True)
    (there / "planted").touch()
    os.chown(there, 4711, 4711)
    said, _, _ = run(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert said.startswith(f"WARNING: compiled code can't be kept in {there}: it belongs to user 4711")
    assert [file.name for file in there.rglob("*") if file.is_file()] == ["planted"]


def test_a_disk_that_fills_as_the_code_is_saved(tmp_path):
    said, cache, _ = run(tmp_path, limit=1000, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert said == ""
    assert cache.is_relative_to(tmp_path / "cache")
    assert all(file.stat().st_size <= 1000 for file in cache.rglob("*") if file.is_file())


def test_the_same_sources_are_compiled_once_wherever_they_are_installed(tmp_path):
    kept = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    for place, wanted in (("one", ["step", "from_c"]), ("one", []), ("other", [])):
        assert run(tmp_path / place, **kept)[2] == wanted


def test_a_user_without_a_home(monkeypatch):
    def unknown(*_):
        raise RuntimeError("Could not determine home directory.")

    for name in ("XDG_CACHE_HOME", "XDG_STATE_HOME", "STATE_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", unknown)
    with pytest.raises(OSError):  # noqa: PT011
        cache_root().mkdir(parents=True)
    assert state_directory().name == "state"
