"""The unit as it is installed, judged by systemd's own checker; needs no root and starts nothing."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from micromanip.host.service.layout import CONFIG, GATEWAY, UNIT, Machine, systemd_version

MOST_EXPOSURE = 30  # 3.0 of 10

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze here")


both = pytest.mark.parametrize("unit", [UNIT, GATEWAY], indirect=True)


def unit_text(machine, name=UNIT):
    return next(text for path, text in machine.files().items() if path.name == name)


@pytest.fixture
def unit(tmp_path, request):
    name = getattr(request, "param", UNIT)
    file = tmp_path / name
    file.write_text(unit_text(Machine(systemd_version(), Path("/usr/bin/true")), name))
    return file


def analyze(*arguments):
    return subprocess.run(["systemd-analyze", *map(str, arguments)], capture_output=True, text=True, check=False)


@both
def test_verify_is_silent(unit):
    """An unknown key or a wrong value ends with 0 too: what counts is that nothing is said."""
    outcome = analyze("verify", "--man=no", unit)
    assert (outcome.returncode, outcome.stdout, outcome.stderr) == (0, "", "")


@both
@pytest.mark.parametrize("folder", ["my tools", "100%", "100%n", "Prüfstand %h"])
def test_verify_finds_the_program_wherever_it_is(unit, folder, tmp_path):
    program = tmp_path / folder / "micromanip"
    program.parent.mkdir()
    shutil.copy("/usr/bin/true", program)
    unit.write_text(unit_text(Machine(systemd_version(), program), unit.name))
    outcome = analyze("verify", "--man=no", unit)
    assert (outcome.returncode, outcome.stdout, outcome.stderr) == (0, "", "")


@both
def test_exposure(unit):
    judged = analyze("security", "--offline=true", f"--threshold={MOST_EXPOSURE}", "--no-pager", unit)
    if "unrecognized option" in judged.stderr:
        pytest.skip("this systemd-analyze can't judge a file: systemd 250 or newer can")
    assert judged.returncode == 0, judged.stdout
    assert f"Overall exposure level for {unit.name}: " in judged.stdout


@pytest.mark.parametrize(("version", "kind"), [(252, "notify"), (253, "notify-reload"), (257, "notify-reload")])
def test_reload_as_the_version_has_it(version, kind):
    text = unit_text(Machine(version, Path("/opt/micromanip/bin/micromanip")))
    assert f"\nType={kind}\n" in text
    assert ("\nExecReload=" in text) == (kind == "notify")


def test_nothing_is_left_to_fill_in():
    files = Machine(252, Path("/opt/micromanip/bin/micromanip")).files()
    assert len(files) == 5
    for path, text in files.items():
        assert path.is_relative_to("/etc")
        assert not re.search(r"@[A-Z_]+@", text), path
    assert f"/opt/micromanip/bin/micromanip run {CONFIG} " in unit_text(
        Machine(252, Path("/opt/micromanip/bin/micromanip"))
    )


def test_stop_has_time_for_the_ramp():
    """systemd must not cut short what the controller gives its loop for the way to park."""
    from micromanip.host.daemon import _STOP_S

    text = unit_text(Machine(252, Path("/usr/bin/true")))
    seconds = float(re.search(r"^TimeoutStopSec=(\d+)$", text, re.MULTILINE)[1])
    assert seconds > _STOP_S + 5
