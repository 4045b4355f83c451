"""Configurations beside each other, as the control socket's verbs answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from micromanip.replies import Change, Difference, Parameter
from micromanip.settings.change import ABSENT, changed, needed, values
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.keys import selected
from micromanip.settings.text.source import key_text


def parameters(configuration: Configuration, keys: Sequence[str]) -> list[Parameter]:
    """Values of `keys`, of all below where one is a section, of all without; UsageError where one is unknown."""
    leaves = values(configuration)
    paths = selected(leaves, configuration.model_dump(mode="json"), keys)
    return [Parameter(key=key_text(path), value=leaves[path], change=needed(path)) for path in paths]


def changes(old: Configuration, new: Configuration) -> list[Change]:
    """What is another value in `new`."""
    return [
        Change(key=key_text(path), old=_shown(before), new=_shown(after))
        for path, (before, after) in changed(old, new).items()
    ]


def differences(file: Configuration, running: Configuration) -> list[Difference]:
    """What runs with another value than the file has."""
    return [
        Difference(key=key_text(path), file=_shown(on_disk), running=_shown(runs), change=needed(path))
        for path, (on_disk, runs) in changed(file, running).items()
    ]


def _shown(value: Any) -> Any:
    return None if value is ABSENT else value
