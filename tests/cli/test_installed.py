"""The built wheel, installed with what it asks for and no extra: each command, and a cell at work."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from importlib.metadata import Distribution, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

pytestmark = [pytest.mark.live, pytest.mark.long, pytest.mark.timeout(1200)]  # it may have to compile all

ROOT = Path(__file__).parents[2]
SOURCE = ("pyproject.toml", "README.md", "LICENSE", "micromanip", "drivers", "config", "systemd", "docs/grafana")
EXTRAS = ("asyncua", "cryptography", "dask", "distributed", "h5py", "prometheus_client", "pyarrow", "pytest", "uvicorn")
HELP = """
import click, micromanip.cli.main as program

def leaves(command, path):
    if not isinstance(command, click.Group):
        return [path]
    each = command.list_commands(None)
    return [path, *(leaf for name in each for leaf in leaves(command.get_command(None, name), [*path, name]))]

asked = leaves(program.cli, [])
for path in asked:
    try:
        program.main([*path, "--help"])
    except SystemExit as ended:
        assert not ended.code, (path, ended.code)
assert len(asked) > 30
"""
CHECK = """
import sys, micromanip.cli.main as program

for file in sys.argv[1:]:
    program.main(["check", file])
"""


def built(folder):
    """The wheel of a copy of the source, in which no other build left anything."""
    for name in SOURCE:
        place = folder / "source" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, place, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        else:
            shutil.copy(ROOT / name, place)
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, folder / "source")
    (wheel,) = folder.glob("micromanip-*.whl")
    return wheel


def pip(*arguments):
    """Without a network."""
    command = [sys.executable, "-m", "pip", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PIP_NO_INDEX": "1"})
    assert done.returncode == 0, done.stderr


def asked_by(requirements, found):
    """All distributions that `requirements` lead to, by their names, into `found`."""
    for text in requirements or ():
        asked = Requirement(text)
        extras = asked.extras or {""}
        if asked.marker is None or any(asked.marker.evaluate({"extra": extra}) for extra in extras):
            known = asked.name in found
            found[asked.name] = distribution(asked.name)
            if not known:
                asked_by(found[asked.name].requires, found)
    return found


def linked(packages, site):
    """What `packages` installed here, and nothing else, in the folder `site`."""
    for package in packages:
        for top in {file.parts[0] for file in package.files if file.parts[0] not in ("..", "__pycache__")}:
            if not (site / top).exists():
                (site / top).symlink_to(package.locate_file(top))


class Installed:
    """What a user has who typed `pip install micromanip-0.1.0-py3-none-any.whl`, and a folder to work in."""

    def __init__(self, folder):
        wheel, self.place, self.work = built(folder), folder / "venv", folder / "work"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", self.place], check=True)
        self.python, self.work_socket = self.place / "bin" / "python", folder / "control.sock"
        self.work.mkdir()
        site = Path(sysconfig.get_path("purelib", vars={"base": self.place, "platbase": self.place}))
        pip("--python", self.python, "install", "--no-deps", "--no-compile", wheel)
        own = next(Distribution.discover(name="micromanip", path=[str(site)]))
        linked(asked_by(own.requires, {}).values(), site)

    def __call__(self, *arguments):
        """Its standard output; it ends with 0."""
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        command = [self.python, *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=self.work, env=environment)
        assert done.returncode == 0, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout

    def micromanip(self, *arguments):
        """What the command printed."""
        return self(self.place / "bin" / "micromanip", *arguments)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    return Installed(tmp_path_factory.mktemp("installed"))


@pytest.fixture(scope="module")
def examples(installed):
    return installed.place / "share" / "micromanip" / "config"


def test_no_extra_is_there(installed):
    installed("-c", f"from importlib.util import find_spec; assert not [m for m in {EXTRAS} if find_spec(m)]")


def test_every_command_has_its_help(installed):
    installed("-c", HELP)


def test_every_example_is_there_and_checked(installed, examples):
    assert {file.name for file in examples.rglob("*.*")} == {file.name for file in (ROOT / "config").rglob("*.*")}
    installed("-c", CHECK, *examples.glob("*.yaml"))


def test_a_cell_runs_and_is_recorded(installed, examples):
    options = ("--duration", 2, "--record", "run.mcap", "--socket", installed.work_socket, "--json")
    report = json.loads(installed.micromanip("run", examples / "simulated.yaml", *options))
    assert report["faults"] == []
    assert report["cycles"] > 10_000
    installed.micromanip("replay", "run.mcap")


def test_an_axis_is_identified(installed, examples):
    identify = ("identify", examples / "factory.yaml", "--axis", "y", "--seconds", 3)
    installed.micromanip(*identify, "--out", "identified")
    installed.micromanip(*identify, "--live", "--yes", "--socket", installed.work_socket, "--out", "identified_live")


def test_an_axis_is_commissioned(installed, examples):
    installed.micromanip("commission", examples / "factory.yaml", "--axis", "y", "--out", "tuned")
    installed.micromanip("check", installed.work / "tuned" / "tuned.yaml")
