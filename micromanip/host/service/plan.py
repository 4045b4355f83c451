"""The steps of installing and of removing the service, in order."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from micromanip.errors import CheckFailed, ConfigError, DeviceUnavailable, PermissionDenied
from micromanip.settings.check import prepare, prepared
from micromanip.settings.text.source import Source

from .layout import CONFIG, GATEWAY, STATE, UNIT, USER, Machine, packaged
from .steps import Remove, Run, Step, WriteFile

_UDEV = Path("/run/udev/control")
_MANAGER = Path("/run/systemd/system")


def install(machine: Machine, config: Path | None, root: Path, warn: Callable[[str], None]) -> list[Step]:
    """Steps that are needed to install the service with this configuration; none where all is as it should be.

    `config` None keeps the one that is installed. Files go below `root`, "/" for this machine. What a person should
    know of the configuration goes to `warn`. Raises ConfigError for a configuration that can't run, or arms by itself.
    """
    theirs = packaged(root)
    files = [WriteFile(_below(root, path), text, root) for path, text in machine.files().items() if path not in theirs]
    files += _configuration(config, _below(root, CONFIG), root, warn)
    enabled = _enabled(root, UNIT)
    steps: list[Step] = [
        *files,
        Run(("systemd-sysusers", *_at(root), "micromanip.conf")),
        Run(("systemd-tmpfiles", *_at(root), "--create", "micromanip.conf")),
        *_told_systemd(root),
        Run(("systemctl", *_at(root), "enable", UNIT), always=not enabled.is_symlink()),
    ]
    return _needed(steps)


def uninstall(machine: Machine, root: Path, *, purge: bool) -> list[Step]:
    """Steps that remove the service; configuration, state and user go only with `purge`."""
    installed = [_below(root, path) for path in machine.files()]
    removals = [Remove(path, root) for path in installed]
    if purge:
        removals += [Remove(_below(root, path), root) for path in (CONFIG.parent, *STATE)]
    steps: list[Step] = []
    enabled = [unit for unit in (GATEWAY, UNIT) if _enabled(root, unit).is_symlink()]
    here = _below(root, Path("/etc/systemd/system") / UNIT).exists()
    units = [*enabled, *([UNIT] if here and UNIT not in enabled else [])]
    now = ["--now"] if root == Path("/") else []
    steps += [Run(("systemctl", *_at(root), "disable", *now, unit), always=unit in enabled) for unit in units]
    steps += removals
    steps += _told_systemd(root)
    if purge and _has_user(root):
        steps.append(Run(("userdel", *(["--root", str(root)] if root != Path("/") else []), USER), always=True))
    return _needed(steps)


def carry_out(steps: Iterable[Step], root: Path, say: Callable[[str], None]) -> None:
    """Do them in order; raises PermissionDenied where this is not root's, DeviceUnavailable without a systemd."""
    steps = list(steps)
    if root == Path("/") and steps:
        if os.geteuid() != 0:
            raise PermissionDenied("installing a service takes root: sudo, or --dry-run to see what would be done")
        if not _MANAGER.is_dir():
            raise DeviceUnavailable("this machine was not booted with systemd; --root DIR prepares another one's files")
    for step in steps:
        sentence = step.sentence
        step.do()
        say(f"done: {sentence}")


def _configuration(config: Path | None, target: Path, root: Path, warn: Callable[[str], None]) -> list[WriteFile]:
    if config is None:
        if not target.is_file():
            raise ConfigError(f"there is no {target} yet: name the CONFIG that the service is to run")
        _fit_for_a_service(target, warn)
        return []
    _fit_for_a_service(config, warn)
    text = config.read_text(encoding="utf-8")
    try:
        prepared(Source.parse(target, text))
    except ConfigError as problem:
        raise CheckFailed(
            f"{problem}\n{config} is good where it is, but relative paths in its copy begin in {target.parent}: "
            "copy what they lead to there first, or make them absolute"
        ) from problem
    return [WriteFile(target, text, root)]


def _fit_for_a_service(file: Path, warn: Callable[[str], None]) -> None:
    """A configuration that nobody is surprised by when the machine is switched on; raises ConfigError."""
    found = prepare(file)
    configuration = found.configuration
    if configuration.arm_on_start:
        raise found.source.error(
            ("arm_on_start",),
            "a service starts with the machine, and again after a crash, when nobody looks: it must wait for "
            "`micromanip arm`; say false",
        )
    if configuration.loop.limits == "simulation":
        warn(f"{file}: loop.limits: simulation, whose fault limits are too wide for anything that really moves")


def _told_systemd(root: Path) -> list[Step]:
    """Commands that make the running system read its files again; none for another machine's."""
    if root != Path("/"):
        return []
    rules: list[Step] = [Run(("udevadm", "control", "--reload"))] if _UDEV.exists() else []
    return [*rules, Run(("systemctl", "daemon-reload"))]


def _enabled(root: Path, unit: str) -> Path:
    """The link that starts it with the machine."""
    return _below(root, Path("/etc/systemd/system/multi-user.target.wants") / unit)


def _has_user(root: Path) -> bool:
    users = _below(root, Path("/etc/passwd"))
    return users.is_file() and any(line.startswith(f"{USER}:") for line in users.read_text().splitlines())


def _needed(steps: list[Step]) -> list[Step]:
    if not any(step.needed() for step in steps):
        return []
    return [step for step in steps if step.needed() or isinstance(step, Run)]


def _below(root: Path, path: Path) -> Path:
    return root / path.relative_to("/")


def _at(root: Path) -> tuple[str, ...]:
    return () if root == Path("/") else (f"--root={root}",)
