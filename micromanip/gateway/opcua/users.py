"""Who may do what by OPC UA: the server's own certificate, and those of the users it knows, in a folder.

``server.pem`` and ``server.key`` are made at the first start. A certificate in ``operate`` may give orders, one in
``observe`` may look; its file's name, without the ending, is noted in the audit trail. The folders are read whenever
somebody comes: a certificate that is put there counts at once, one that is removed from the next session on.
"""

from __future__ import annotations

import contextlib
import datetime
import os
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.crypto.cert_gen import (
    dump_private_key_as_pem,
    generate_private_key,
    generate_self_signed_app_certificate,
)
from asyncua.crypto.permission_rules import USER_TYPES, PermissionRuleset, User, UserRole
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID

from micromanip.errors import ConfigError, PermissionDenied, system_error

from ..certificates import checked, ends_soon

APPLICATION_URI = "urn:micromanip:gateway"
SCOPES = ("operate", "observe")
_CERTIFICATE, _KEY = "server.pem", "server.key"
_ENDINGS = (".pem", ".crt", ".cer", ".der")
_DAYS = 3650
_AGAIN_S = 60.0
_MEND = f"put new ones there, or remove {_CERTIFICATE} and {_KEY}: others are made, which clients have to trust again"


class RateLimitedLog:
    """Lines about what clients do, one a minute at most: a client that asks often can't fill the journal."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._next_s, self._silent = -1.0, 0

    def event(self, text: str) -> None:
        """That it has happened; the next line says how many events had none."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            self._silent += 1
            return
        more = f" ({self._silent} more since the last line)" if self._silent else ""
        self._next_s, self._silent = now_s + _AGAIN_S, 0
        self._say(text + more)


@dataclass
class CellUser(User):  # type: ignore[misc]
    """Somebody with a session; `operates`: may give orders."""

    operates: bool = False


class Rules(PermissionRuleset):  # type: ignore[misc]
    """Nobody writes; who may operate calls methods."""

    def __init__(self, speaking: Any) -> None:
        """`speaking` is a context variable that is told who asks."""
        every = {ua.NodeId(number) for number in USER_TYPES}
        write, call = (
            ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")) for name in ("Write", "Call")
        )
        self._to_operate, self._to_observe, self._speaking = every - {write}, every - {write, call}, speaking

    def check_validity(self, user: CellUser, action_type_id: Any, _body: Any) -> bool:
        """Whether `user` may ask this."""
        self._speaking.set(user)
        return action_type_id in (self._to_operate if user.operates else self._to_observe)


class Users:
    """Those of a folder; with `strangers_observe` anybody may look."""

    def __init__(self, folder: Path, log: RateLimitedLog, *, strangers_observe: bool) -> None:
        self._folder, self._log, self._strangers_observe = folder, log, strangers_observe

    def get_user(
        self,
        iserver: Any,  # noqa: ARG002
        username: Any = None,  # noqa: ARG002
        password: Any = None,  # noqa: ARG002
        certificate: bytes | None = None,
    ) -> User | None:
        """Who has this certificate (DER), whose key was proven; None sends him away. As asyncua asks."""
        if certificate is not None:
            for scope, name, known in self._known():
                if known.public_bytes(Encoding.DER) == certificate:
                    now = datetime.datetime.now(datetime.UTC)
                    if not known.not_valid_before_utc <= now <= known.not_valid_after_utc:
                        self._log.event(
                            f"OPC UA: {name} was sent away: the certificate is valid from "
                            f"{known.not_valid_before_utc:%Y-%m-%d} to {known.not_valid_after_utc:%Y-%m-%d}"
                        )
                        return None
                    return CellUser(UserRole.User, name, operates=scope == "operate")
        if self._strangers_observe:
            return CellUser(UserRole.User, "somebody")
        self._log.event(f"OPC UA: a client was sent away whose certificate is not in {self._folder}")
        return None

    def _known(self) -> Iterator[tuple[str, str, x509.Certificate]]:
        for scope in SCOPES:
            for file in sorted((self._folder / scope).glob("*")):
                with contextlib.suppress(OSError, ValueError):
                    yield scope, file.stem, _certificate(file.read_bytes())


class Own(NamedTuple):
    """The server's certificate and key, whether they were made just now, what will be wrong with them soon; the first
    as it is shown.
    """

    certificate: Path
    key: Path
    is_new: bool
    warning: str | None
    shown: x509.Certificate


def prepared_folder(folder: Path) -> Own:
    """What the server shows, made where there is none.

    Raises PermissionDenied where others may read the key or put certificates there, ConfigError where one is unusable.
    """
    certificate, key = folder / _CERTIFICATE, folder / _KEY
    try:
        for place in (folder, *(folder / scope for scope in SCOPES)):
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            if place.stat().st_mode & 0o022:
                raise PermissionDenied(f"{place}: others may put certificates there; chmod go-w {place}")
        is_new = not key.exists()
        if is_new:
            _make(certificate, key)
        shown = checked(certificate, key, _MEND)
        for scope in SCOPES:
            for file in sorted((folder / scope).iterdir()):
                _check_user(file)
    except OSError as problem:
        raise system_error(problem, folder) from problem
    soon = ends_soon(shown)
    return Own(certificate, key, is_new, None if soon is None else f"{certificate} {soon}; {_MEND}", shown)


def _make(certificate: Path, key: Path) -> None:
    private = generate_private_key()
    made = generate_self_signed_app_certificate(
        private,
        "micromanip gateway",
        {},
        [x509.UniformResourceIdentifier(APPLICATION_URI), x509.DNSName(socket.gethostname())],
        [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH],
        _DAYS,
    )
    certificate.write_bytes(made.public_bytes(Encoding.PEM))
    descriptor = os.open(key, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(dump_private_key_as_pem(private))


def _check_user(file: Path) -> None:
    wanted = f"a certificate, PEM or DER, in a file that ends in {', '.join(_ENDINGS)}"
    if file.suffix not in _ENDINGS:
        raise ConfigError(f"{file}: expected {wanted}")
    try:
        _certificate(file.read_bytes())
    except ValueError as problem:
        raise ConfigError(f"{file}: expected {wanted}") from problem


def _certificate(content: bytes) -> x509.Certificate:
    if b"-----BEGIN" in content:
        return x509.load_pem_x509_certificate(content)
    return x509.load_der_x509_certificate(content)
