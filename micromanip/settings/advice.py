"""What a valid configuration had better not say: told by `check`, `run` and `set`, refused by nobody."""

from __future__ import annotations

from micromanip.settings.schema.model import Configuration
from micromanip.settings.text.place import Finding
from micromanip.settings.wiring.places import Wiring

from .ages import age_warnings
from .commissioned import changes_since
from .feedback import feedback_warnings
from .reach import reach_warnings


def advice(configuration: Configuration, wiring: Wiring) -> list[Finding]:
    """Everything that is told of a configuration, each at its key, in the order in which it is told."""
    return [
        *changes_since(configuration.axes),
        *feedback_warnings(configuration, wiring),
        *reach_warnings(configuration),
        *age_warnings(configuration),
    ]
