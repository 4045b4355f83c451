"""What comes in: commands, of which one is heeded, and whether the primary host is there."""

from __future__ import annotations

import json
from dataclasses import dataclass

from google.protobuf.message import DecodeError

from .node import NAMESPACE, REBIRTH
from .schema import Payload

_MOST_NAMED = 3


@dataclass(frozen=True)
class Command:
    """Of a host application; `ignored` says what of it is not heeded, None where all of it is."""

    asks_rebirth: bool
    ignored: str | None


def command(topic: str, content: bytes) -> Command:
    """Of an NCMD or a DCMD. A rebirth is given; nothing is ever written, so everything else is ignored."""
    kind = topic.split("/")[2]
    try:
        metrics = Payload.FromString(content).metrics
    except DecodeError:
        return Command(False, f"{kind} that is no payload of Sparkplug B")
    births = [m for m in metrics if kind == "NCMD" and m.name == REBIRTH]
    others = [m.name or f"alias {m.alias}" for m in metrics if not (kind == "NCMD" and m.name == REBIRTH)]
    named = ", ".join(ascii(name)[1:61] for name in others[:_MOST_NAMED]).replace("'", "")
    more = f" and {len(others) - _MOST_NAMED} more" if len(others) > _MOST_NAMED else ""
    ignored = f"{kind} of {named}{more}" if others else None
    return Command(any(m.boolean_value for m in births), ignored)


class PrimaryHost:
    """The host application without which nothing is published, as its retained STATE tells (3.0)."""

    def __init__(self, name: str) -> None:
        self.topic = f"{NAMESPACE}/STATE/{name}"
        self.is_online = False
        self._told_ms = -1

    def hear(self, content: bytes) -> None:
        """A STATE; what is older than the last, or none at all, changes nothing."""
        try:
            told = json.loads(content)
            online, told_ms = told["online"], told["timestamp"]
        except (ValueError, TypeError, KeyError, RecursionError):
            return
        if isinstance(online, bool) and isinstance(told_ms, int) and told_ms >= self._told_ms:
            self.is_online, self._told_ms = online, told_ms
