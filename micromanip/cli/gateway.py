"""``micromanip gateway``: the web scope, the cell page and the metrics, as a process of their own."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import click

from micromanip.bus.rights import leave_cpu
from micromanip.errors import ConfigError
from micromanip.extras import required

from .options import Answer, Messages, config_argument, socket_option, subcommand

_TOKENS, _OPCUA = "gateway-tokens", "gateway-opcua"


def _in_state_directory(name: str) -> Path:
    """That of the service, else the user's own."""
    from micromanip.host.state_directory import state_directory

    return state_directory() / name


@subcommand(
    "gateway",
    """micromanip gateway config/simulated.yaml
         micromanip gateway cell.yaml --listen 0.0.0.0:8443 --tls-certificate cell.pem --tls-key cell.key
         micromanip gateway cell.yaml --behind-proxy https://cell.example
         micromanip gateway cell.yaml --opcua 127.0.0.1:4840""",
)
@config_argument
@click.option("--listen", default="127.0.0.1:8090", metavar="HOST:PORT", help="Where browsers find it.")
@socket_option
@click.option(
    "--tokens",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help=f"File of tokens, made at the first start.  [default: {_TOKENS} in the state directory]",
)
@click.option("--tls-certificate", type=click.Path(path_type=Path), help="Certificate chain, PEM.")
@click.option("--tls-key", type=click.Path(path_type=Path), help="Its private key, PEM, without a password.")
@click.option(
    "--behind-proxy", metavar="ADDRESS", help="A proxy does TLS; ADDRESS is what people open: https://cell.example."
)
@click.option("--opcua", metavar="HOST:PORT", help="Serve OPC UA there, too (extra `opcua`).  [default: off]")
@click.option(
    "--opcua-folder",
    type=click.Path(path_type=Path, file_okay=False),
    help=f"Certificates for OPC UA, made at the first start.  [default: {_OPCUA} in the state directory]",
)
def command(
    config: Path,
    listen: str,
    socket_path: Path,
    tokens: Path | None,
    tls_certificate: Path | None,
    tls_key: Path | None,
    behind_proxy: str | None,
    opcua: str | None,
    opcua_folder: Path | None,
) -> Answer:
    """Show the running cell in browsers: a page of the cell, a scope, and metrics for Prometheus.

    CONFIG is what the controller is expected to run; the pages say so where it does not. The gateway reads the
    telemetry and asks the control socket for everything else: the loop does not notice whether it runs. It needs the
    extra `gateway`.
    """
    with required("gateway", "gateway"):
        from micromanip.gateway.serving import Options, serve
    os.umask(0o077)
    options = Options(
        config,
        socket_path,
        listen,
        tokens or _in_state_directory(_TOKENS),
        tls_certificate,
        tls_key,
        behind_proxy,
        opcua,
        opcua_folder or _in_state_directory(_OPCUA),
    )
    leave_cpu(_loop_cpu(config))
    messages = Messages()
    serve(options, messages)
    return Answer({"listen": listen, "messages": messages})


def _loop_cpu(config: Path) -> int | None:
    """The CPU that the configuration gives to the loop; None where it gives none, or is none that can be read."""
    from micromanip.settings.load import validate_section
    from micromanip.settings.schema.model import Loop
    from micromanip.settings.text.source import Source

    with contextlib.suppress(ConfigError):
        source = Source.read(config)
        if isinstance(source.data, dict) and "loop" in source.data:
            return validate_section(source, ("loop",), Loop, source.data["loop"]).cpu
    return None
