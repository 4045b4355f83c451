"""Pictures of docs/analyse.md: what `analyse` finds for axis x of the tuned simulation."""

from __future__ import annotations

from collections.abc import Iterator

from matplotlib.figure import Figure

from micromanip.design.analysis import analyse_axis
from micromanip.design.analysis_figures import describing_function, drawn_plants, loops_of, nyquist
from micromanip.settings.check import Prepared
from micromanip.virtual.experiment import VirtualExperiment

_PLANTS = range(1, 101)


def analysis_drawings(prepared: Prepared) -> Iterator[tuple[str, Figure]]:
    """Describing function, Nyquist curves and drawn plants, with the names of their files."""
    analysis = analyse_axis(prepared.configuration, "x", VirtualExperiment(prepared), _PLANTS, jobs=-1)
    assert analysis.inverse is not None
    yield "describing_function", describing_function(analysis.inverse)
    yield "nyquist", nyquist(loops_of(analysis), analysis.settings.accept)
    yield "drawn_plants", drawn_plants(analysis.samples, analysis.settings.accept)
