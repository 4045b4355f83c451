"""What an installation is made of: files written or removed, commands run; each can say what it would do."""

from __future__ import annotations

import difflib
import subprocess
from dataclasses import dataclass
from pathlib import Path

from micromanip.errors import CheckFailed, PermissionDenied
from micromanip.files import held


@dataclass(frozen=True)
class WriteFile:
    """A text file with this content."""

    path: Path
    text: str
    root: Path = Path("/")

    def needed(self) -> bool:
        """Is it missing, or another one?"""
        return self._present() != self.text

    @property
    def sentence(self) -> str:
        """What it would do."""
        if self._present() is not None:
            return f"change {self.path}"
        return f"{'replace the link' if self.path.is_symlink() else 'create'} {self.path}"

    @property
    def diff(self) -> list[str]:
        """Lines that change; of a new file all of it."""
        present = self._present()
        old = [] if present is None else present.splitlines()
        return list(difflib.unified_diff(old, self.text.splitlines(), "installed", "new", lineterm="", n=1))

    def do(self) -> None:
        """Write it whole or not at all, through nobody's link; raises PermissionDenied, CheckFailed."""
        try:
            with held(self.path, make=True, below=self.root) as (folder, name):
                folder.write(name, self.text.encode(), 0o644)
        except OSError as problem:
            raise _refused(problem, self.path) from problem

    def _present(self) -> str | None:
        try:
            with held(self.path, below=self.root) as (folder, name):
                content = folder.read(name)
        except FileNotFoundError:
            return None
        except OSError as problem:
            raise _refused(problem, self.path) from problem
        return None if content is None else content.decode(errors="replace")


@dataclass(frozen=True)
class Remove:
    """A file or a folder with all that is in it, gone."""

    path: Path
    root: Path = Path("/")

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
            with held(self.path, below=self.root) as (folder, name):
                folder.remove(name)
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
