"""What a tracker's samples showed, as a configuration holds it."""

from __future__ import annotations

import copy
from collections.abc import Mapping

from micromanip.errors import ConfigError
from micromanip.settings.check import prepared
from micromanip.settings.text.source import Source
from micromanip.settings.write import write_into

from .fit import Deviation


def require_tracker(source: Source) -> None:
    """ConfigError unless a configuration follows one."""
    reference = source.data.get("reference")
    if not isinstance(reference, dict) or reference.get("source") != "signal":
        raise ConfigError(f"{source.path}: reference.source must be signal: there is no tracker to describe")


def put(source: Source, found: Mapping[str, Deviation]) -> None:
    """Write what was found of each axis into the file; raises ConfigError where `check` would refuse it."""
    document = copy.deepcopy(source.data)
    reference = document["reference"]
    reference["axes"] = {**reference.get("axes", {}), **{axis: each.settings() for axis, each in found.items()}}
    prepared(Source.of(document, source.path))
    write_into(source, document)
