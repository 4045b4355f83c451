"""Holds what ``replay --with`` predicts against the truth: drawn tunings on a simulated recording, each simulated anew.

The simulated cell is recorded once while it tracks, from before the tool comes into contact. For every drawn tuning the
cell then runs again from its start, with the same noise, path and force; its path error over the same cycles is the
truth. Tunings are drawn before anything is predicted; one that the configuration's check refuses is drawn again, and
counted.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import ConfigError
from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry
from micromanip.replay.counterfactual import DRAWS, FIGURES, Prediction, Rerun, predict
from micromanip.replay.fitting import fit_models
from micromanip.replay.window import recorded_configuration, take_window
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import Prepared, prepared, revise, validate
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.source import Source
from micromanip.virtual.cell import VirtualCell

from .report import ROOT, Asked, Report

CONFIG = ROOT / "config" / "simulated.yaml"
WITHIN = 0.1
"""Of the true rms, at most."""
TRACKED_S = 4.0
"""From 3.4 s on; the tool comes into contact at 5 s."""
_FACTORS = {
    "inner.K_V_per_um": (0.5, 1.2),
    "inner.Ti_ms": (0.8, 4.0),
    "inner.Td_ms": (0.4, 1.2),
    "outer.control_weight": (0.1, 10.0),
    "outer.disturbance_um": (0.2, 5.0),
    "outer.oscillation_um": (0.3, 10.0),
    "outer.sensor_noise_um": (0.5, 2.0),
    "outer.input_noise_um": (0.3, 3.0),
}
"""By how much each key of an axis may be more or less, drawn evenly over the logarithm, each axis for itself."""
_TRACKER = {"reference.noise_um": (0.3, 3.0), "reference.jerk_um_per_s3": (0.2, 5.0)}


@dataclass(frozen=True)
class Compared:
    """A drawn tuning: what was predicted, and rms, p99 and peak (3, axes) as they truly are."""

    values: dict[str, float]
    prediction: Prediction
    truth: np.ndarray[Any, Any]

    @property
    def wrong(self) -> Any:
        """Relative error (3, axes) of the prediction."""
        return self.prediction.expected.um / self.truth - 1.0

    @property
    def covers(self) -> Any:
        """Whether (3, axes) the truth lies in the interval."""
        expected = self.prediction.expected
        return (expected.low_um <= self.truth) & (self.truth <= expected.high_um)


def recorded_cell() -> Prepared:
    """The simulated cell as it is commissioned."""
    return prepared(Source.read(CONFIG))


def track(cell: Prepared, parameters: Any, stalls: Sequence[tuple[float, int]] = ()) -> Any:
    """Rows (n,) of the cell from its start on, `TRACKED_S` of them behind its arming.

    `stalls` are moments (s, of the tracking) from which on the next cycle comes so many periods later.
    """
    wiring = prepared(cell.source).wiring
    virtual = VirtualCell(parameters.copy(), wiring, cell.samples, list(cell.configuration.axes))
    rows, period_s = [virtual.arm()], int(parameters[0]["period_ns"]) * 1e-9
    begin, periods = 0, 1
    for at_s, late in [*stalls, (TRACKED_S, 1)]:
        end = round(at_s / period_s)
        rows.append(virtual.run((end - begin) * period_s, periods=periods))
        begin, periods = end, late
    return np.concatenate(rows)


def record(cell: Prepared, rows: Any, file: Path) -> None:
    """`rows` as the recorder files them."""
    configuration = cell.configuration
    about = {"configuration": cell.source.text, "sha256": cell.source.hash, "file": str(file)}
    written = McapRecording(about | {"axes": list(configuration.axes), "period_ns": configuration.loop.period_ns})
    written.begin(VirtualCell(cell.parameters, cell.wiring).state[0], cell.samples)
    for first in range(0, len(rows), 4096):
        written.append(np.ascontiguousarray(rows[first : first + 4096], ROW), cell.parameters)
    written.close()


def drawn(cell: Prepared, number: int, seed: int) -> tuple[list[tuple[dict[str, float], Prepared]], int]:
    """`number` tunings that the check accepts, and how many it refused."""
    random, found, refused = np.random.default_rng(seed), [], 0
    data, source = cell.source.data, cell.source
    while len(found) < number:
        values = {key: _shifted(cell, key, span, random) for key, span in _TRACKER.items()}
        for axis in cell.configuration.axes:
            for key, span in _FACTORS.items():
                values[f"axes.{axis}.{key}"] = _shifted(cell, f"axes.{axis}.{key}", span, random)
        known = cell.configuration.model_dump(mode="json")
        try:
            tuned = Source.of(assigned(data, known, values), source.path)
            found.append((values, revise(cell, validate(tuned), tuned)))
        except ConfigError:
            refused += 1
    return found, refused


def _shifted(cell: Prepared, key: str, span: tuple[float, float], random: np.random.Generator) -> float:
    value: Any = cell.configuration
    for part in key.split("."):
        value = value[part] if isinstance(value, dict) else getattr(value, part)
    return float(f"{value * np.exp(random.uniform(*np.log(span))):.4g}")


def compared(number: int, seed: int, draws: int = DRAWS) -> Iterator[Compared | int]:
    """Each drawn tuning held against its truth; first, how many the check refused."""
    cell = recorded_cell()
    tunings, refused = drawn(cell, number, seed)
    yield refused
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        record(cell, track(cell, cell.parameters), file)
        telemetry = open_telemetry(file)
        window = take_window(telemetry)
    rerun = Rerun(window, fit_models(window, recorded_configuration(telemetry)[1]))
    first = window.rows["cycle"][0]
    for values, tuned in tunings:
        rows = track(cell, tuned.parameters)
        rows = rows[(rows["cycle"] >= first)][: len(window.rows)]
        yield Compared(values, predict(rerun, tuned.parameters, draws), rerun.figures(rows))


def run(asked: Asked) -> Report:
    """`count` tunings; wrong is an rms that is predicted worse than `WITHIN`."""
    found: list[Compared] = []
    report = Report()
    for each in compared(asked.count, asked.seed + 16):
        if isinstance(each, int):
            report.notes.append(f"The configuration's check refused {each} more tunings.")
            continue
        found.append(each)
        for i, axis in enumerate("xyz"):
            if abs(each.wrong[0, i]) > WITHIN:
                report.wrong.append(f"tuning {len(found)}, axis {axis}: rms {100 * each.wrong[0, i]:+.1f} % off")
        asked.tell(f"{len(found)} of {asked.count}")
    wrong, covers = np.abs([each.wrong for each in found]), np.array([each.covers for each in found])
    report.tables["error of what was predicted"] = [
        {"figure": name, "median, %": 100 * float(np.median(wrong[:, k])), "worst, %": 100 * float(wrong[:, k].max()),
         "interval covers": f"{covers[:, k].sum()} of {covers[:, k].size}"}
        for k, name in enumerate(FIGURES)
    ]  # fmt: skip
    return report
