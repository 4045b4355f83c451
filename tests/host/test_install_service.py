"""``micromanip system install`` into a folder: what it says, does, leaves alone and undoes; commands run on paper."""

import json
import os
import stat
from pathlib import Path

import pytest

from micromanip.cli.main import main
from micromanip.errors import CheckFailed, DeviceUnavailable
from micromanip.host.service import layout, plan
from micromanip.host.service.steps import Run
from tests.cells import SLOW as ARMING
from tests.cells import changed

SLOW = changed(ARMING, ("arm_on_start: true", "arm_on_start: false"))


@pytest.fixture
def root(tmp_path, monkeypatch):
    """An empty machine whose commands do nothing but what enabling does."""
    root = tmp_path / "machine"
    root.mkdir()
    machine = layout.Machine(252, Path("/opt/micromanip/bin/micromanip"))
    monkeypatch.setattr(layout, "this_machine", lambda report: machine)
    wants = root / "etc/systemd/system/multi-user.target.wants/micromanip.service"

    def do(step):
        if "enable" in step.command:
            wants.parent.mkdir(parents=True, exist_ok=True)
            wants.unlink(missing_ok=True)
            wants.symlink_to("../micromanip.service")
        if "disable" in step.command:
            wants.unlink()

    monkeypatch.setattr(Run, "do", do)
    return root


@pytest.fixture
def config(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(SLOW)
    return file


@pytest.fixture
def typed(root, capsys):
    """Types a command; its exit code, standard output and standard error."""

    def typed(*arguments):
        code = 0
        try:
            main(["system", "install", "--root", str(root), *map(str, arguments)])
        except SystemExit as end:
            code = end.code
        return code, *capsys.readouterr()

    return typed


def files(root):
    return sorted("/" + str(path.relative_to(root)) for path in root.rglob("*") if path.is_file())


def test_dry_run_shows_everything_and_does_nothing(typed, root, config):
    code, out, _ = typed(config, "--dry-run")
    assert code == 0
    shown = [line for line in out.splitlines() if line.startswith("    +")]
    assert [line[5:] for line in shown if "ramp_s:" in line] == [line for line in SLOW.splitlines() if "ramp_s" in line]
    assert any(line.startswith("    +ExecStart=/opt/micromanip/bin/micromanip run /etc/") for line in shown)
    assert [line for line in out.splitlines() if not line.startswith("    ")] == [
        f"create {root}/etc/systemd/system/micromanip.service",
        f"create {root}/etc/systemd/system/micromanip-gateway.service",
        f"create {root}/etc/sysusers.d/micromanip.conf",
        f"create {root}/etc/tmpfiles.d/micromanip.conf",
        f"create {root}/etc/udev/rules.d/90-micromanip.rules",
        f"create {root}/etc/micromanip/cell.yaml",
        f"run systemd-sysusers --root={root} micromanip.conf",
        f"run systemd-tmpfiles --root={root} --create micromanip.conf",
        f"run systemctl --root={root} enable micromanip.service",
    ]
    assert files(root) == []


def test_it_is_done_once_and_a_change_is_shown_as_a_difference(typed, root, config):
    assert typed(config, "--yes")[0] == 0
    assert (root / "etc/micromanip/cell.yaml").read_text() == SLOW
    assert len(files(root)) == 7  # and the link that enables it
    assert typed(config, "--yes")[1] == "nothing to do: all is as it should be\n"
    assert typed()[1] == "nothing to do: all is as it should be\n"

    config.write_text(changed(SLOW, ("ramp_s: 0.2", "ramp_s: 0.3")))
    (root / "etc/udev/rules.d/90-micromanip.rules").unlink()
    code, out, _ = typed(config, "--json", "--yes")
    assert code == 0
    report = json.loads(out)
    assert report["done"]
    assert [step["step"].split(" ")[0] for step in report["steps"]] == ["create", "change", "run", "run", "run"]
    difference = report["steps"][1]["diff"]
    assert [line for line in difference if line[0] in "+-" and line[:3] not in ("+++", "---")] == [
        "-start: {lift_s: 0.1, settle_s: 0.0, authority_s: 0.1, ramp_s: 0.2}",
        "+start: {lift_s: 0.1, settle_s: 0.0, authority_s: 0.1, ramp_s: 0.3}",
    ]
    assert typed("--json", "--dry-run")[1] == '{\n  "steps": [],\n  "done": false,\n  "warnings": []\n}\n'


def test_a_package_s_files_stand_for_those_in_etc(typed, root, config):
    """Only one that is as this program has it; what an administrator has in /etc goes before it."""
    for path, text in layout.PACKAGED.files().items():
        theirs = root / "usr/lib" / path.relative_to("/etc")
        theirs.parent.mkdir(parents=True, exist_ok=True)
        theirs.write_text(text)
    other = root / "usr/lib/tmpfiles.d/micromanip.conf"
    other.write_text("")
    assert typed(config, "--yes")[0] == 0
    assert [file for file in files(root) if file.startswith("/etc")] == [
        "/etc/micromanip/cell.yaml",
        "/etc/tmpfiles.d/micromanip.conf",
    ]
    assert typed("--uninstall")[1].startswith(f"run systemctl --root={root} disable micromanip.service\n")


def test_without_an_answer_nothing_is_done(typed, root, config):
    code, _, err = typed(config)
    assert code == 64
    assert "add --yes" in err
    assert files(root) == []


def test_uninstall_keeps_what_is_yours_until_purge(typed, root, config):
    typed(config, "--yes")
    (root / "var/lib/micromanip").mkdir(parents=True)
    (root / "var/lib/micromanip/audit.log").write_text("")
    code, out, _ = typed("--uninstall", "--yes")
    assert code == 0
    assert out.splitlines()[0] == f"run systemctl --root={root} disable micromanip.service"
    assert files(root) == ["/etc/micromanip/cell.yaml", "/var/lib/micromanip/audit.log"]
    assert typed("--uninstall")[1] == "nothing to do: all is as it should be\n"
    assert typed("--uninstall", "--purge", "--yes")[0] == 0
    assert files(root) == []
    assert typed("--uninstall", "--purge")[1] == "nothing to do: all is as it should be\n"


def test_a_wrong_configuration_is_not_installed(typed, root, config):
    config.write_text(changed(SLOW, ("rate_hz: 200", "rate_hz: fast")))
    code, _, err = typed(config, "--yes")
    assert code == 78
    assert f"{config}:2: loop.rate_hz" in err
    code, _, err = typed("--yes")
    assert code == 78
    assert "name the CONFIG" in err
    assert files(root) == []


def test_a_service_does_not_arm_by_itself(typed, root, config):
    config.write_text(ARMING)
    code, _, err = typed(config, "--yes")
    assert code == 78
    line = 1 + ARMING[: ARMING.index("arm_on_start")].count("\n")
    assert err.startswith(f"micromanip: {config}:{line}: arm_on_start: a service starts with the machine")
    assert files(root) == []
    config.write_text(SLOW)
    typed(config, "--yes")
    (root / "etc/micromanip/cell.yaml").write_text(ARMING)  # edited where it is
    assert typed("--yes")[0] == 78


def test_this_machine_only_as_root_and_with_systemd(root, config, monkeypatch):
    steps = [Run(("true",))]
    monkeypatch.setattr(plan.os, "geteuid", lambda: 1000)
    with pytest.raises(plan.PermissionDenied, match="sudo, or --dry-run"):
        plan.carry_out(steps, Path("/"), print)
    monkeypatch.setattr(plan.os, "geteuid", lambda: 0)
    monkeypatch.setattr(plan, "_MANAGER", root / "none")
    with pytest.raises(DeviceUnavailable, match="not booted with systemd"):
        plan.carry_out(steps, Path("/"), print)


def raising(problem):
    raise problem


def test_a_program_that_the_service_would_not_see(monkeypatch, tmp_path):
    (tmp_path / "micromanip").write_text("")
    (tmp_path / "python").write_text("")
    monkeypatch.setattr(layout.sys, "executable", str(tmp_path / "python"))
    monkeypatch.setattr(layout, "_HIDDEN", (str(tmp_path),))
    with pytest.raises(CheckFailed, match="a service does not see; install the program elsewhere"):
        layout.this_machine(raising)
    (tmp_path / "micromanip").unlink()
    with pytest.raises(CheckFailed, match="is not there: install the program"):
        layout.this_machine(raising)


PLANTED = {
    "the configuration": ("etc/micromanip/cell.yaml", "link"),
    "what it was written into before": ("etc/micromanip/cell.yaml.new", "link"),
    "a FIFO": ("etc/micromanip/cell.yaml", "fifo"),
    "a hard link": ("etc/micromanip/cell.yaml", "hard link"),
}


@pytest.mark.parametrize(("where", "kind"), PLANTED.values(), ids=PLANTED)
def test_what_is_planted_in_the_group_s_folder_is_not_followed(typed, root, config, tmp_path, where, kind):
    """Members of the group may write in /etc/micromanip: nothing that they put there leads root elsewhere."""
    precious = tmp_path / "precious"
    precious.write_text("root:x:0:0::/root:/bin/sh\n")
    precious.chmod(0o600)
    place = root / where
    place.parent.mkdir(parents=True)
    place.parent.chmod(0o2770)
    {"link": place.symlink_to, "hard link": place.hardlink_to, "fifo": lambda _: os.mkfifo(place)}[kind](precious)
    code, out, err = typed(config, "--yes")
    assert code == 0, out + err
    assert precious.read_text() == "root:x:0:0::/root:/bin/sh\n"
    assert stat.S_IMODE(precious.stat().st_mode) == 0o600
    installed = root / "etc/micromanip/cell.yaml"
    assert not installed.is_symlink()
    assert installed.read_text() == SLOW
    assert installed.stat().st_nlink == 1


@pytest.mark.parametrize("arguments", [("--yes",), ("--uninstall", "--purge", "--yes")])
def test_a_planted_folder_is_not_walked_through(typed, root, config, tmp_path, arguments):
    """A link in the place of a folder: refused, whoever made it; what it leads to stays."""
    typed(config, "--yes")
    precious = tmp_path / "precious"
    (precious / "rules.d").mkdir(parents=True)
    (precious / "rules.d" / "90-micromanip.rules").write_text("precious")
    udev = root / "etc/udev"
    udev.rename(tmp_path / "former")
    udev.symlink_to(precious)
    code, _, err = typed(*((str(config), *arguments) if "--uninstall" not in arguments else arguments))
    assert code == 77
    assert "udev is a link that may lead anywhere" in err
    assert [path.read_text() for path in (precious / "rules.d").iterdir()] == ["precious"]
