"""What the file of ``gateway --sparkplug FILE`` says."""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from micromanip.errors import ConfigError, system_error

from ..addresses import is_local
from ..certificates import checked
from ..private import read_private

_PLAIN_PORT, _TLS_PORT = 1883, 8883
Name = Annotated[str, Field(pattern=r"^[^/+#\x00-\x1f]{1,100}$")]
"""A part of a topic: MQTT's own characters are not for names."""
Deadband = Annotated[float, Field(ge=0.0)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Tls(_Section):
    """How the broker's certificate is judged, and ours shown."""

    ca: Path | None = Field(
        None, description="who may have signed the broker's certificate; null: whom the system trusts"
    )
    certificate: Path | None = Field(None, description="our certificate, PEM, for brokers that ask for one")
    key: Path | None = Field(None, description="its key, PEM, without a password")

    @model_validator(mode="after")
    def _both(self) -> Self:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key go together")
        return self


class Deadbands(_Section):
    """By how much a value of this unit has to change before it is sent again."""

    um: Deadband = 0.5
    V: Deadband = 0.1
    Hz: Deadband = 5.0
    us: Deadband = 20.0


class Options(_Section):
    """Where the broker is, what we are called there, and when something is worth saying."""

    host: Annotated[str, Field(min_length=1, description="name or address of the broker")]
    port: int | None = Field(None, ge=1, le=65535, description="null: 1883, or 8883 with tls")
    group: Name
    node: Name
    tls: Tls | None = None
    user: str | None = None
    password_file: Path | None = Field(None, description="the password in one line; nobody else may read it")
    primary_host: Name | None = Field(None, description="host application without which nothing is published")
    period_s: float = Field(1.0, ge=0.25, le=60.0, description="at most so often a value is sent")
    deadbands: Deadbands = Deadbands()

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.password_file is not None and self.user is None:
            raise ValueError("user missing, which the password is of")
        if self.password_file is not None and self.tls is None and not is_local(self.host):
            raise ValueError("tls missing: the password would cross the network for everybody to read; write `tls: {}`")
        return self

    @property
    def port_used(self) -> int:
        """The port of the broker."""
        return self.port or (_PLAIN_PORT if self.tls is None else _TLS_PORT)

    @property
    def client(self) -> str:
        """What the broker knows us by: the same after a restart, so that a session that was left there ends first."""
        return f"micromanip/{self.group}/{self.node}"

    def beside(self, folder: Path) -> Options:
        """The same, with paths that were relative to `folder`."""
        tls = self.tls
        if tls is not None:
            tls = tls.model_copy(update={name: folder / path for name, path in tls if path is not None})
        file = self.password_file
        return self.model_copy(update={"tls": tls, "password_file": None if file is None else folder / file})

    def password(self) -> str | None:
        """Out of its file; PermissionDenied where others may read it, ConfigError where it is not one line."""
        path = self.password_file
        if path is None:
            return None
        lines = read_private(path, "this password").splitlines()
        if len(lines) != 1 or not lines[0]:
            raise ConfigError(f"{path}: expected the password of the broker in one line, found {len(lines)} lines")
        return lines[0]

    def context(self) -> ssl.SSLContext | None:
        """For TLS, None without; ConfigError where a certificate can't be used."""
        tls = self.tls
        if tls is None:
            return None
        try:
            made = ssl.create_default_context(cafile=tls.ca)
            if tls.certificate is not None and tls.key is not None:
                checked(tls.certificate, tls.key)
                made.load_cert_chain(tls.certificate, tls.key, password="")
        except ssl.SSLError as problem:
            raise ConfigError(f"{tls.ca}: no certificates in PEM: {problem.reason or problem}") from problem
        except OSError as problem:
            raise system_error(problem, tls.ca) from problem
        return made
