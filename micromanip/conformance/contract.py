"""The whole suite: subclass it as ``Test...``, and pytest runs every check."""

from __future__ import annotations

from .death import DeathChecks
from .description import DescriptionChecks
from .lifetime import LifetimeChecks
from .link import LinkChecks
from .reading import ReadingChecks
from .running import RunningChecks
from .writing import WritingChecks


class BusDriverContract(
    DescriptionChecks, LifetimeChecks, ReadingChecks, WritingChecks, LinkChecks, RunningChecks, DeathChecks
):
    """Every check of a bus driver; ``hooks.py`` has what a subclass gives.

    Each check starts a peer of its own and takes no fixtures. ``pytest -rs`` lists those that were left out, and why.
    """
