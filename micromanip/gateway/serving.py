"""The gateway's server: where it listens, with what certificate, and its life."""

from __future__ import annotations

import contextlib
import hashlib
import ipaddress
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import uvicorn

from micromanip.errors import (
    ConfigError,
    DeviceUnavailable,
    MicromanipError,
    PermissionDenied,
    UsageError,
    system_error,
)
from micromanip.extras import required

from .app import Gateway
from .cell import Cell
from .certificates import checked, ends_soon, is_for, names
from .fields import fields
from .guard import Origins
from .history import History
from .impatient import Impatient
from .session import MESSAGE_BYTES
from .tokens import load_tokens

if TYPE_CHECKING:
    from .opcua.service import OpcUa

_STOP_S = 2
_MOST_AXES = ["x", "y", "z"]
_EVERY = ("0.0.0.0", "::")
"""To listen on all addresses of this computer."""


@dataclass(frozen=True)
class Options:
    """What the command line says; `listen` and `opcua` are HOST:PORT, `behind_proxy` the address that people open."""

    config: Path
    control: Path
    listen: str
    tokens: Path
    certificate: Path | None = None
    key: Path | None = None
    behind_proxy: str | None = None
    opcua: str | None = None
    opcua_folder: Path = Path("gateway-opcua")


def _sha256(config: Path) -> str:
    """Of its text as it is now; raises ConfigError, PermissionDenied or another error of this program."""
    try:
        return hashlib.sha256(config.read_bytes().decode("utf-8-sig").encode()).hexdigest()
    except UnicodeDecodeError as problem:
        raise ConfigError(f"{config}: not a text of UTF-8: {problem}") from problem
    except OSError as problem:
        raise system_error(problem, config) from problem


def serve(options: Options, say: Callable[[str], None]) -> None:
    """Serve until SIGINT or SIGTERM.

    Raises ConfigError, UsageError, PermissionDenied or DeviceUnavailable where it can't begin.
    """
    expected = _sha256(options.config)
    host, port = parsed_address(options.listen, "--listen")
    origins = _origins(options, host)
    tokens, is_new = load_tokens(options.tokens)
    expiries: dict[str, float] = {}
    called = _check_certificate(options, host, expiries, say)
    cell = Cell(options.control)

    def differs() -> str | None:
        nonlocal expected
        with contextlib.suppress(MicromanipError):  # `save` and `apply` replace it; one that is gone is as it was
            expected = _sha256(options.config)
        status = cell.status
        if status is None or status["configuration_sha256"] == expected:
            return None
        return (
            f"The controller runs {status['configuration']}, which is not what {options.config} says now: another "
            "configuration, or values that were changed (`micromanip diff`)."
        )

    opcua = None if options.opcua is None else _opcua(options.opcua, options.opcua_folder, cell, expiries, say)
    with listening(host, port, "--listen") as socket_:
        address = options.behind_proxy or f"{origins.scheme}://{shown(called, socket_.getsockname()[1])}"

        @contextlib.asynccontextmanager
        async def beside() -> AsyncIterator[None]:
            """What serves beside the pages; each is told of when it does."""
            async with contextlib.AsyncExitStack() as stack:
                if opcua is not None:
                    await stack.enter_async_context(opcua.serving())
                    say(f"OPC UA at {opcua.url}; certificates in {options.opcua_folder}")
                say(f"cell page at {address}/, scope at {address}/scope; tokens in {options.tokens}; Ctrl-C ends it")
                yield

        if is_new:
            say(f"made new tokens in {options.tokens}: one to observe, one to operate")
        memory_MB = History(fields(_MOST_AXES)).nbytes / 1e6
        say(f"the history of an hour takes {memory_MB:.0f} MB with three axes, all of it once there is a controller")
        gateway = Gateway(cell, tokens, origins, differs, beside, expiries=lambda: expiries)
        run(gateway, socket_, options.certificate, options.key)


def run(gateway: Gateway, socket_: socket.socket, certificate: Path | None = None, key: Path | None = None) -> None:
    """Serve it on a socket that listens, until SIGINT or SIGTERM."""
    config = uvicorn.Config(
        gateway.guard,
        http=Impatient,
        ws="websockets-sansio",
        ws_max_size=MESSAGE_BYTES,
        ws_per_message_deflate=False,
        log_level="warning",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=_STOP_S,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    with contextlib.suppress(KeyboardInterrupt):
        uvicorn.Server(config).run([socket_])


def _opcua(listen: str, folder: Path, cell: Cell, expiries: dict[str, float], say: Callable[[str], None]) -> OpcUa:
    with required("--opcua", "opcua"):
        from .opcua.service import OpcUa
    host, port = parsed_address(listen, "--opcua")
    with listening(host, port, "--opcua"):
        pass  # it is free: asyncua would end the gateway with a traceback
    made = OpcUa(cell, host, port, folder, say, is_local=is_local(host))
    if made.own.is_new:
        say(f"made a certificate for OPC UA in {folder}; put those of clients into operate/ or observe/ there")
    if made.own.warning is not None:
        say(made.own.warning)
    expiries[str(made.own.certificate)] = made.own.shown.not_valid_after_utc.timestamp()
    return made


def _origins(options: Options, host: str) -> Origins:
    if (options.certificate is None) != (options.key is None):
        raise UsageError("--tls-certificate and --tls-key go together")
    if options.behind_proxy is not None:
        try:
            return Origins.behind(options.behind_proxy)
        except ValueError as problem:
            raise UsageError(
                "--behind-proxy is the address that people open, a name of its own without a path, such as "
                "https://cell.example"
            ) from problem
    if options.certificate is not None:
        return Origins("https")
    if not is_local(host):
        raise UsageError(
            f"--listen {options.listen}: whoever can read along on the network would have the tokens; give "
            "--tls-certificate and --tls-key, or --behind-proxy ADDRESS with a proxy that does TLS, or listen "
            "on 127.0.0.1"
        )
    return Origins()


def _check_certificate(options: Options, host: str, expiries: dict[str, float], say: Callable[[str], None]) -> str:
    """The host that the address is told with; what will keep browsers away is said.

    Raises ConfigError or PermissionDenied where certificate and key can't be used.
    """
    if options.certificate is None or options.key is None:
        return host
    found = checked(options.certificate, options.key)
    expiries[str(options.certificate)] = found.not_valid_after_utc.timestamp()
    if (soon := ends_soon(found)) is not None:
        say(f"{options.certificate} {soon}; browsers and scrapers will refuse it then")
    named = names(found)
    if host in _EVERY:
        return next((name for name in named if not name.startswith("*")), host)
    if not is_for(found, host):
        say(
            f"{options.certificate} is for {', '.join(named) or 'no host'}, not for {host}: browsers refuse it there; "
            "open it by such a name, or have one made for it"
        )
    return host


def parsed_address(listen: str, option: str) -> tuple[str, int]:
    """Host and port of `listen`, HOST:PORT, as `option` has it; UsageError for anything else."""
    host, separator, port = listen.rpartition(":")
    if not separator or not port.isdigit() or int(port) > 65535 or not host:
        raise UsageError(f"{option} {listen}: expected HOST:PORT, such as 127.0.0.1:8090 or [::1]:8090")
    return host.strip("[]"), int(port)


def shown(host: str, port: int) -> str:
    """As an address has them."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def is_local(host: str) -> bool:
    """Whether only this computer reaches it."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@contextlib.contextmanager
def listening(host: str, port: int, option: str) -> Iterator[socket.socket]:
    """A socket there, for `option`; PermissionDenied or DeviceUnavailable where none can be."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((host, port))
        except PermissionError as problem:
            raise PermissionDenied(f"{option} {host}:{port}: {problem.strerror}; take a port from 1024 on") from problem
        except OSError as problem:
            raise DeviceUnavailable(
                f"{option} {host}:{port}: {problem.strerror or problem}; choose another address or port"
            ) from problem
        yield made
