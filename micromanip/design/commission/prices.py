"""What more bandwidth costs: a loop designed again where one thing is better than it is, on paper."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from micromanip.control.system import delay
from micromanip.errors import CheckFailed

from ..analyse.loop_analysis import SLOPES
from ..analyse.loops import over_path
from ..identify.actuation import Actuator
from ..report.model import Section, Table
from ..synthesise import OuterDesign, PidDesign
from ..synthesise.search import FRAGILE, SLEWED, UNKNOWN


@dataclass(frozen=True)
class Price:
    """What one thing would buy: the loop's highest crossover (Hz), and the share that it leaves of 10 Hz, if known."""

    what: str
    bandwidth_Hz: float
    left: float | None = None


def strain_prices(
    tune: Callable[..., PidDesign], given: Mapping[str, Any], actuator: Actuator, design: PidDesign
) -> tuple[Price, ...]:
    """The strain loop as designed, ``tune(**given)``, and with each thing better that holds it back."""
    path, cycles = actuator.path, actuator.delay
    half = replace(path, strain_late=path.strain_late // 2, output_late=path.output_late // 2)
    faster = over_path(delay(cycles // 2, actuator.system.period_s).then(actuator.dynamics), half)
    better: dict[str, dict[str, Any]] = {
        "as it is": {},
        "with half the gauge's noise": {"residual": 0.5 * given["residual"]},
        "without more hysteresis than slopes of .75 to 1.3 times": {"slopes": SLOPES},
        "with a response that is known exactly": {"radius": None},
    }
    if cycles > 1 or half != path:
        better["with half the delay"] = {"actuator": faster}
    found = []
    for what, change in better.items():
        try:
            as_it_is = all(given[name] is value for name, value in change.items())
            pid = design if as_it_is else tune(**{**given, **change})
        except CheckFailed:
            continue
        nominal = pid.margins[pid.slopes.index(1.0)]
        found.append(Price(what, max(nominal.crossovers_Hz, default=0.0), pid.residual_10Hz))
    return tuple(found)


_HELP: dict[str, tuple[str, dict[str, Any]]] = {
    UNKNOWN: ("with a response that is known exactly", {"unsure": np.zeros_like}),
    FRAGILE: ("for the nominal plant alone, at its own slope", {"bears": None}),
    SLEWED: ("with a set-point of any speed", {"reach": None}),
}


def outer_prices(tune: Callable[..., OuterDesign], given: Mapping[str, Any], design: OuterDesign) -> tuple[Price, ...]:
    """The outer loop as designed, ``tune(**given)``, and without what holds it back most, or quieter."""
    quieter = "with half the stage sensor's noise", {"noise_um": 0.5 * given["noise_um"]}
    what, change = _HELP.get(design.obstacle, quieter)
    prices = [Price("as it is", design.bandwidth_Hz)]
    try:
        better = tune(**{name: value for name, value in {**given, **change}.items() if value is not None})
    except CheckFailed:
        return tuple(prices)
    return (*prices, Price(what, better.bandwidth_Hz))


def section(loops: Mapping[str, tuple[str, tuple[Price, ...]]]) -> Section:
    """Of the report: what holds each loop back, in words, and the prices."""
    rows = [
        (
            loop if k == 0 else "",
            price.what,
            f"{price.bandwidth_Hz:.3g} Hz",
            "" if price.left is None else f"{100 * price.left:.2g} %",
        )
        for loop, (_, prices) in loops.items()
        for k, price in enumerate(prices)
    ]
    text = (
        "Each loop is designed again, on paper, with one thing better than it is. Where the bandwidth stays, that "
        "thing does not hold it back."
    )
    heads = ("Loop", "Designed", "Highest crossover", "Left of a disturbance at 10 Hz")
    holds = {f"{loop} loop": words for loop, (words, _) in loops.items()}
    return Section("Bandwidth, and what more would cost", text, holds, (), (Table("Bandwidth", heads, rows),))
