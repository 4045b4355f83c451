"""Holds what ``replay --with`` predicts against the truth: drawn tunings on a simulated recording, each simulated anew.

    python -m tools.counterfactual [--number N] [--seed S]

The simulated cell is recorded once while it tracks, from before the tool comes into contact. For every drawn tuning the
cell then runs again from its start, with the same noise, path and force; its path error over the same cycles is the
truth. Tunings are drawn before anything is predicted; one that the configuration's check refuses is drawn again, and
counted.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from micromanip.errors import ConfigError
from micromanip.host.recording.mcap_file import McapRecording
from micromanip.recordings import open_telemetry
from micromanip.replay.comparable import recorded_configuration
from micromanip.replay.counterfactual import DRAWS, FIGURES, Prediction, Rerun, predict
from micromanip.replay.fitting import fit_models
from micromanip.replay.window import take_window
from micromanip.rt.telemetry import ROW
from micromanip.settings.check import Prepared, prepared, revise, validate
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.source import Source
from micromanip.virtual.cell import VirtualCell

CONFIG = Path(__file__).resolve().parents[1] / "config" / "simulated.yaml"
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


def run(cell: Prepared, parameters: Any, stalls: Sequence[tuple[float, int]] = ()) -> Any:
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
        record(cell, run(cell, cell.parameters), file)
        telemetry = open_telemetry(file)
        window = take_window(telemetry)
    rerun = Rerun(window, fit_models(window, recorded_configuration(telemetry)[1]))
    first = window.rows["cycle"][0]
    for values, tuned in tunings:
        rows = run(cell, tuned.parameters)
        rows = rows[(rows["cycle"] >= first)][: len(window.rows)]
        yield Compared(values, predict(rerun, tuned.parameters, draws), rerun.figures(rows))


def main() -> None:
    """Print a row for every tuning, and how good all of them are together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=20)
    parser.add_argument("--seed", type=int, default=17)
    given = parser.parse_args()
    found = []
    for each in compared(given.number, given.seed):
        if isinstance(each, int):
            print(f"{given.number} tunings drawn with seed {given.seed}; the check refused {each} more")
            print("axis rms: recorded, truly, predicted (interval); relative error of rms, p99, peak")
            continue
        found.append(each)
        p = each.prediction
        for i, axis in enumerate("xyz"):
            print(
                f"{len(found):3d} {axis}  {p.recorded[0, i]:.3f}  {each.truth[0, i]:.4f}  {p.expected.um[0, i]:.4f} "
                f"({p.expected.low_um[0, i]:.4f}..{p.expected.high_um[0, i]:.4f})  "
                + " ".join(f"{100 * wrong:+.2f} %" for wrong in each.wrong[:, i])
                + ("" if p.stopped_s is None else f"  would stop at {p.stopped_s:.2f} s"),
                flush=True,
            )
    wrong, covers = np.abs([each.wrong for each in found]), np.array([each.covers for each in found])
    for k, name in enumerate(FIGURES):
        most, median = 100 * wrong[:, k].max(), 100 * np.median(wrong[:, k])
        count = f"{covers[:, k].sum()} of {covers[:, k].size}"
        print(f"{name}: relative error at most {most:.2f} %, median {median:.2f} %; the interval covers {count}")


if __name__ == "__main__":
    main()
