"""Where the service's files go, and their contents: the templates of ``systemd/`` filled in for this machine."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import micromanip
from micromanip.errors import CheckFailed, DeviceUnavailable, MicromanipError
from micromanip.shipped import shipped

UNIT, GATEWAY = "micromanip.service", "micromanip-gateway.service"
CONFIG = Path("/etc/micromanip/cell.yaml")
STATE = (Path("/var/lib/micromanip"), Path("/var/cache/micromanip"))
USER = "micromanip"

_TARGETS = {
    "micromanip.service.in": Path("/etc/systemd/system") / UNIT,
    "micromanip-gateway.service.in": Path("/etc/systemd/system") / GATEWAY,
    "micromanip.sysusers.conf": Path("/etc/sysusers.d/micromanip.conf"),
    "micromanip.tmpfiles.conf": Path("/etc/tmpfiles.d/micromanip.conf"),
    "90-micromanip.rules": Path("/etc/udev/rules.d/90-micromanip.rules"),
}
_NOTIFY_RELOAD_SINCE = 253
_ELSEWHERE = "/opt/micromanip"
_VENDOR = Path("/usr/lib")
"""Where a package has its files, whose places in /etc are an administrator's."""
_UNNAMEABLE = frozenset("\"'\\")
"""Refused by systemd in the path of a program, however it is quoted."""
_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")


@dataclass(frozen=True)
class Machine:
    """What the files depend on: the version of systemd, and the program to start."""

    systemd: int
    program: Path

    def files(self) -> dict[Path, str]:
        """Text of each file by its path, as seen from the root of the machine."""
        folder = _templates()
        return {target: self._filled((folder / name).read_text(encoding="utf-8")) for name, target in _TARGETS.items()}

    def _filled(self, text: str) -> str:
        reloads = self.systemd >= _NOTIFY_RELOAD_SINCE
        values = {
            "@TYPE@": "notify-reload" if reloads else "notify",
            "@EXEC_RELOAD@": "# reload: SIGHUP, by the type" if reloads else "ExecReload=/bin/kill -HUP $MAINPID",
            "@PROGRAM@": _quoted(self.program),
            "@CONFIG@": str(CONFIG),
        }
        for name, value in values.items():
            text = text.replace(name, value)
        return text


PACKAGED = Machine(0, Path(_ELSEWHERE) / "bin" / "micromanip")
"""What a package is made for: any version of systemd, the program in its own place."""


def packaged(root: Path) -> set[Path]:
    """Those of the files, as seen from the root of the machine below `root`, in whose stead a package has one."""

    def has(path: Path, text: str) -> bool:
        vendor, own = (root / place.relative_to("/") for place in (_VENDOR / path.relative_to("/etc"), path))
        return not own.exists() and vendor.is_file() and vendor.read_text(encoding="utf-8") == text

    return {path for path, text in PACKAGED.files().items() if has(path, text)}


def this_machine(report: Callable[[MicromanipError], None]) -> Machine:
    """The running one.

    `report` gets what stands in the way of a service here: a CheckFailed where it can't see the program, a
    DeviceUnavailable without systemd. It raises it, or goes on as if that were mended.
    """
    program = Path(sys.executable).with_name("micromanip")
    if not program.is_file():
        report(CheckFailed(f"{program} is not there: install the program, e.g. into {_ELSEWHERE} (docs/your-cell.md)"))
    package = Path(micromanip.__file__ or "").resolve().parent
    if found := _UNNAMEABLE.intersection(str(program)):
        told = f"{program}: systemd starts nothing whose path has {' or '.join(sorted(found))} in it"
        report(CheckFailed(f"{told}; install the program elsewhere, e.g. into {_ELSEWHERE} (docs/your-cell.md)"))
    for path in (program, Path(sys.executable).resolve(), package):
        if any(path.is_relative_to(hidden) for hidden in _HIDDEN):
            report(
                CheckFailed(
                    f"{path} lies in a folder that a service does not see; install the program elsewhere, e.g. into "
                    f"{_ELSEWHERE} (docs/your-cell.md)"
                )
            )
            program = Path(_ELSEWHERE) / "bin" / "micromanip"
            break
    try:
        version = systemd_version()
    except DeviceUnavailable as problem:
        report(problem)
        version = _NOTIFY_RELOAD_SINCE
    return Machine(version, program)


def systemd_version() -> int:
    """Major version of this machine's systemd; raises DeviceUnavailable where it has none."""
    try:
        said = subprocess.run(("systemctl", "--version"), capture_output=True, text=True, check=True).stdout
        return int(said.split()[1].partition(".")[0])
    except (OSError, subprocess.CalledProcessError, IndexError, ValueError) as problem:
        raise DeviceUnavailable(
            "this machine has no systemd; start `micromanip run CONFIG` by other means"
        ) from problem


def _quoted(program: Path) -> str:
    """As the first word of a command in a unit, where a space would end it and % begins a specifier."""
    text = str(program).replace("%", "%%")
    return f'"{text}"' if any(character.isspace() for character in text) else text


def _templates() -> Path:
    """The folder ``systemd/``; raises CheckFailed where it is not there."""
    place = shipped("systemd")
    if (place / "micromanip.service.in").is_file():
        return place
    raise CheckFailed(f"this installation lacks the service's files; they belong into {place}")
