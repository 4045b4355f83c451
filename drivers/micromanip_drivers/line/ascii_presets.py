"""What is known of the protocols that have a preset.

gcs: the General Command Set 2.0 of Physik Instrumente. `POS? 1 2` is answered by a line per axis, `1=12.3`;
`SVA 1 12.3` is not answered; `ERR?` tells the number of the last error and forgets it; `*IDN?` tells who answers.

command,value: a command, perhaps a channel, and a value with commas between, as amplifiers of piezosystem jena take
them. `rk,0` is answered by `rk,0,12.3`; `set,0,12.3` is not answered, or by `err,2`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from micromanip.driver import ConfigError

from .ascii_options import Ascii, AsciiInput, AsciiOutput, Errors, Read, Write

_ENDS = {"LF": "\n", "CR": "\r", "CRLF": "\r\n"}
_TERMINATORS = {"gcs": "LF", "command,value": "CR"}
_ERRORS = {"gcs": Errors(request="ERR?"), "command,value": Errors(reply="err,{code}")}
_MEANINGS = {
    "gcs": {
        1: "parameter syntax error",
        2: "unknown command",
        5: "axis unreferenced, or its servo is off",
        7: "position out of limits",
        10: "stopped by a command",
        15: "no such axis",
        17: "parameter out of range",
        23: "illegal axis",
        24: "wrong number of parameters",
        302: "voltage out of limits",
        303: "open-loop command while the servo is on",
    }
}

Step = tuple[str, Sequence[str]]
"""Template of a request, and those of the lines that answer it."""


def terminator(options: Ascii) -> str:
    """End of the lines that are sent."""
    return _ENDS[options.terminator or _TERMINATORS[options.preset or ""]]


def errors(options: Ascii) -> Errors | None:
    """How the device says that something was wrong."""
    return options.errors or _ERRORS.get(options.preset or "")


def meaning(options: Ascii, code: int) -> str:
    """A number of an error, in words where they are known."""
    words = _MEANINGS.get(options.preset or "", {}).get(code)
    return f"{code} ({words})" if words else str(code)


def identity(options: Ascii) -> tuple[str, str | None]:
    """What asks for the identity, empty where nothing is known that does; and the pattern of the answer."""
    request = "*IDN?" if options.preset == "gcs" else ""
    given = options.identity
    return (given.request or request, given.pattern) if given else (request, None)


def steps(options: Ascii, key: str, exchange: Read | Write) -> list[Step]:
    """What is sent and answered, one after the other. Raises ConfigError."""
    if exchange.request is not None:
        return [(exchange.request, exchange.reply)]
    command, fields = exchange.command or "", exchange.fields
    if options.preset == "gcs":
        return [_gcs(key, command, fields, isinstance(exchange, Write))]
    return [_command_value(command, name, field, isinstance(exchange, Write)) for name, field in fields.items()]


def read_back(options: Ascii, write: Write) -> Step | None:
    """What asks for the values that `write` sends: in GCS the command with a question mark, `SVA? 1 2` for `SVA`."""
    if options.preset != "gcs" or write.command is None:
        return None
    items = {name: field.item for name, field in write.fields.items()}
    return " ".join([f"{write.command}?", *items.values()]), [f"{item}={{{name}}}" for name, item in items.items()]


def _gcs(key: str, command: str, fields: Mapping[str, AsciiInput] | Mapping[str, AsciiOutput], writes: bool) -> Step:
    for name, field in fields.items():
        if not field.item:
            raise ConfigError(f"{key}.fields.{name}.item: is missing: the axis, as the controller calls it")
    if writes:
        return " ".join([command, *(f"{field.item} {{{name}}}" for name, field in fields.items())]), ()
    request = " ".join([command, *(field.item for field in fields.values())])
    return request, [f"{field.item}={{{name}}}" for name, field in fields.items()]


def _command_value(command: str, name: str, field: AsciiInput, writes: bool) -> Step:
    asked = f"{command},{field.item}" if field.item else command
    told = f"{asked},{{{name}}}"
    return (told, ()) if writes else (asked, (told,))
