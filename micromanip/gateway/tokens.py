"""Who may use the gateway: tokens in a file that nobody but its owner reads, each with a name and a scope.

A line is `name scope token`; what begins with # is a comment. A scope is observe, or operate, which may observe too.
"""

from __future__ import annotations

import hmac
import io
import os
import re
import secrets
from dataclasses import dataclass
from pathlib import Path

from micromanip.errors import ConfigError, PermissionDenied, system_error
from micromanip.files import open_regular

SCOPES = ("observe", "operate")
_LEAST_CHARS = 20
_NAME = re.compile(r"[\w.@-]{1,40}", re.ASCII)
_TOKEN = re.compile(r"[\x21-\x7e]+")
_HEADER = """\
# Tokens of micromanip's gateway: name, scope (observe or operate) and token, a line each.
# Whoever knows an operate token can arm this cell. The name is noted in the audit trail.
"""


@dataclass(frozen=True)
class Token:
    """One line; `name` is noted in the audit trail."""

    name: str
    scope: str
    secret: str

    @property
    def operates(self) -> bool:
        """Whether it may ask for what moves something."""
        return self.scope == "operate"


class Tokens:
    """All tokens of a gateway."""

    def __init__(self, tokens: list[Token]) -> None:
        self._tokens = tokens

    def find(self, secret: str) -> Token | None:
        """The token with this secret; None where there is none. All are compared, each in constant time."""
        found = None
        for token in self._tokens:
            if hmac.compare_digest(token.secret.encode(), secret.encode(errors="replace")):
                found = token
        return found


def load_tokens(path: Path) -> tuple[Tokens, bool]:
    """Those in `path`, and whether it was made just now, with one token of each scope.

    Raises ConfigError where a line is wrong, PermissionDenied where others may read it.
    """
    is_new = False
    try:
        if not path.exists():
            _make(path)
            is_new = True
    except OSError as problem:
        raise system_error(problem, path) from problem
    text = read_private(path, "these tokens")
    return Tokens(_parsed(text, path)), is_new


def _make(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [
        f"{name} {scope} {secrets.token_urlsafe(24)}\n"
        for name, scope in (("screen", "observe"), ("operator", "operate"))
    ]
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(_HEADER + "".join(lines))


def _parsed(text: str, path: Path) -> list[Token]:
    tokens: list[Token] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or line.lstrip().startswith("#"):
            continue
        where = f"{path}:{number}"
        if len(words) != 3:
            raise ConfigError(f"{where}: expected `name scope token`, found {len(words)} words")
        token = Token(*words)
        if not _NAME.fullmatch(token.name):
            raise ConfigError(f"{where}: a name has up to 40 letters, digits and _.@-")
        if token.scope not in SCOPES:
            raise ConfigError(f"{where}: {token.name}: a scope is observe or operate, not {token.scope!r:.40}")
        if len(token.secret) < _LEAST_CHARS or not _TOKEN.fullmatch(token.secret):
            raise ConfigError(f"{where}: {token.name}: a token has at least {_LEAST_CHARS} printable ASCII characters")
        if any(other.name == token.name or other.secret == token.secret for other in tokens):
            raise ConfigError(f"{where}: {token.name}: this name or token is there already")
        tokens.append(token)
    if not tokens:
        raise ConfigError(f"{path}: there is no token in it; remove the file, and new ones are made")
    return tokens


def read_private(path: Path, holds: str, *, group_may: bool = False) -> str:
    """The text of `path`, which `holds` says in words; PermissionDenied where others may read it, too.

    With `group_may` the file's group is let read it. Raises what `system_error` makes of a file that can't be read.
    """
    try:
        with io.TextIOWrapper(open_regular(path), encoding="utf-8", errors="replace") as file:
            found = os.fstat(file.fileno())
            if found.st_mode & (0o037 if group_may else 0o077):
                mode = "640" if group_may else "600"
                raise PermissionDenied(
                    f"{path}: others may read {holds}; make a new one, or `chmod {mode} {path}` where nobody has"
                )
            return file.read()
    except OSError as problem:
        raise system_error(problem, path) from problem
