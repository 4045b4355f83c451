"""From a file to a validated configuration, or to messages that say on which line what is wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from micromanip.settings.schema.faults import with_limits
from micromanip.settings.schema.model import Configuration
from micromanip.settings.text import problems
from micromanip.settings.text.place import Path as KeyPath
from micromanip.settings.text.source import Source

Model = TypeVar("Model", bound=BaseModel)


def load(file: Path) -> Configuration:
    """Read a configuration; ConfigError says a line a problem, ``FILE:LINE: key.path: what is wrong``."""
    configuration, _ = load_with_source(file)
    return configuration


def load_with_source(file: Path) -> tuple[Configuration, Source]:
    """The configuration, and where each of its keys stands, for rules that span several sections."""
    source = Source.read(file)
    return validate_document(source), source


def validate_document(source: Source) -> Configuration:
    """The configuration that a file or a document holds; ConfigError as `load`."""
    if not isinstance(source.data, Mapping):
        found = "nothing" if source.data is None else "a list" if isinstance(source.data, list) else "a single value"
        keys = ", ".join(Configuration.model_fields)
        raise source.error((), f"expected the sections {keys}; the file holds {found}")
    return validate_section(source, (), Configuration, with_limits(source.data))


def validate_section(source: Source, path: KeyPath, model: type[Model], data: object) -> Model:
    """Validate a section that a driver has a model of its own for; ConfigError as for the rest of the file."""
    try:
        # YAML data has JSON's types and is validated as such: a strict model then takes a list for a tuple.
        return model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise source.errors(problems.findings(error, model, path)) from None
