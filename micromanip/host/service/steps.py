"""What an installation is made of: files written or removed, commands run; each can say what it would do."""

from __future__ import annotations

import difflib
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from micromanip.errors import CheckFailed, PermissionDenied


@dataclass(frozen=True)
class WriteFile:
    """A text file with this content."""

    path: Path
    text: str

    def needed(self) -> bool:
        """Is it missing, or another one?"""
        return self._present() != self.text

    @property
    def sentence(self) -> str:
        """What it would do."""
        return f"{'create' if self._present() is None else 'change'} {self.path}"

    @property
    def diff(self) -> list[str]:
        """Lines that change; none for a new file."""
        present = self._present()
        lines = difflib.unified_diff(
            (present or "").splitlines(), self.text.splitlines(), "installed", "new", lineterm="", n=1
        )
        return [] if present is None else list(lines)

    def do(self) -> None:
        """Write it whole or not at all; raises PermissionDenied, CheckFailed."""
        new = self.path.with_name(self.path.name + ".new")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            new.write_text(self.text, encoding="utf-8")
            new.chmod(0o644)
            new.replace(self.path)
        except OSError as problem:
            raise _refused(problem, self.path) from problem

    def _present(self) -> str | None:
        try:
            return self.path.read_text(encoding="utf-8", errors="replace")
        except FileNotFoundError:
            return None
        except OSError as problem:
            raise _refused(problem, self.path) from problem


@dataclass(frozen=True)
class Remove:
    """A file or a folder with all that is in it, gone."""

    path: Path

    def needed(self) -> bool:
        """Is it there?"""
        return self.path.is_symlink() or self.path.exists()

    @property
    def sentence(self) -> str:
        """What it would do."""
        return f"remove {self.path}"

    diff = ()

    def do(self) -> None:
        """Remove it; raises PermissionDenied, CheckFailed."""
        try:
            if self.path.is_dir() and not self.path.is_symlink():
                shutil.rmtree(self.path)
            else:
                self.path.unlink(missing_ok=True)
        except OSError as problem:
            raise _refused(problem, self.path) from problem


@dataclass(frozen=True)
class Run:
    """A command of the system; it runs where something else changes, or `always`."""

    command: tuple[str, ...]
    always: bool = False

    def needed(self) -> bool:
        """Even if nothing else is?"""
        return self.always

    @property
    def sentence(self) -> str:
        """What it would do."""
        return f"run {' '.join(self.command)}"

    diff = ()

    def do(self) -> None:
        """Run it; raises CheckFailed with what it said."""
        try:
            done = subprocess.run(self.command, capture_output=True, text=True, check=False)
        except OSError as problem:
            raise CheckFailed(f"{self.command[0]} can't be run: {problem.strerror}") from problem
        if done.returncode != 0:
            said = " ".join((done.stderr or done.stdout).split())
            raise CheckFailed(f"`{' '.join(self.command)}` ended with {done.returncode}: {said}")


Step = WriteFile | Remove | Run


def _refused(problem: OSError, path: Path) -> CheckFailed | PermissionDenied:
    kind = PermissionDenied if isinstance(problem, PermissionError) else CheckFailed
    return kind(f"{path}: {problem.strerror}")
