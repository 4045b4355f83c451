"""Parts of the simulated cell, and the recordings that `run --record` would have made of them."""

from pathlib import Path

from micromanip.recordings import Telemetry

CONFIG = Path(__file__).parents[3] / "config" / "simulated.yaml"
SECONDS = 2.5


def recording(prepared, rows, name="run.mcap", text=None, **changed):
    """Of `rows`; `changed` columns stand in the place of theirs."""
    rows = rows.copy()
    for column, value in changed.items():
        (rows if column in rows.dtype.names else rows["axis"])[column] = value

    def column_of(path):
        return rows["axis"][path.split(".")[2]][:, int(path.split(".")[1])] if path.startswith("axis.") else rows[path]

    return Telemetry(
        Path(name), list(prepared.configuration.axes), prepared.configuration.loop.period_ns, rows.dtype,
        prepared.source.text if text is None else text, prepared.source.hash, {},
        lambda paths: iter([{path: column_of(path) for path in paths}]), lambda: iter([rows]), lambda: iter([]),
    )  # fmt: skip
