"""Another tuning of a cell, by the keys that differ."""

from micromanip.settings.check import revise, validate
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.source import Source


def tuned(cell, values):
    """The set of `cell` with `values` by key."""
    known = cell.configuration.model_dump(mode="json")
    source = Source.of(assigned(cell.source.data, known, values), cell.source.path)
    return revise(cell, validate(source), source).parameters
