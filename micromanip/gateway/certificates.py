"""Whether a certificate of ours will be believed: looked at before anything is served with it."""

from __future__ import annotations

import datetime
import ipaddress
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from micromanip.errors import ConfigError, system_error
from micromanip.files import open_regular

from .tokens import read_private

WARN_DAYS = 30


def checked(certificate: Path, key: Path, mend: str = "have a new one made") -> x509.Certificate:
    """The first certificate in `certificate` (PEM), which is valid now, and whose key is in `key`.

    Raises ConfigError where it is not, with `mend` as what to do; PermissionDenied where others may read the key. Its
    group may: so Debian keeps keys for several programs.
    """
    try:
        with open_regular(certificate) as opened:
            content = opened.read()
    except OSError as problem:
        raise system_error(problem, certificate) from problem
    try:
        found = x509.load_pem_x509_certificates(content)[0]
        public = found.public_key()
    except (ValueError, UnsupportedAlgorithm) as problem:
        raise ConfigError(f"{certificate}: not a certificate in PEM, of a kind that is known here") from problem
    try:
        private = load_pem_private_key(read_private(key, "this key", group_may=True).encode(), None)
    except TypeError as problem:
        raise ConfigError(f"{key}: this key has a password; write it without one, `openssl pkey`") from problem
    except (ValueError, UnsupportedAlgorithm) as problem:
        raise ConfigError(f"{key}: not a private key in PEM, of a kind that is known here") from problem
    if public != private.public_key():
        raise ConfigError(f"{key} is not the key of {certificate}; {mend}")
    now = datetime.datetime.now(datetime.UTC)
    if found.not_valid_after_utc < now:
        raise ConfigError(f"{certificate} expired on {found.not_valid_after_utc:%Y-%m-%d}; {mend}")
    if found.not_valid_before_utc > now:
        raise ConfigError(
            f"{certificate} is valid from {found.not_valid_before_utc:%Y-%m-%d %H:%M} UTC on, and now it is "
            f"{now:%Y-%m-%d %H:%M}; wait, or set the clock"
        )
    return found


def ends_soon(certificate: x509.Certificate) -> str | None:
    """That it expires within 30 days, else None."""
    left = certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    if left >= datetime.timedelta(days=WARN_DAYS):
        return None
    return f"expires on {certificate.not_valid_after_utc:%Y-%m-%d}, in {left.days} days"


def names(certificate: x509.Certificate) -> list[str]:
    """Hosts and addresses that it is for, as browsers look at it: its subject does not count."""
    try:
        told = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [*told.get_values_for_type(x509.DNSName), *map(str, told.get_values_for_type(x509.IPAddress))]


def is_for(certificate: x509.Certificate, host: str) -> bool:
    """Whether it is for `host`; a name that begins with ``*.`` is for each host directly below."""
    try:
        wanted = str(ipaddress.ip_address(host))
    except ValueError:
        wanted = host.lower().rstrip(".")
    below = "*." + wanted.partition(".")[2]
    return any(name.lower() in (wanted, below) for name in names(certificate))
