"""What a recording, an MCAP file, says of itself: topics, metadata, attachments (docs/record-and-replay.md)."""

from __future__ import annotations

import hashlib
from pathlib import Path

from micromanip import rt

FORMAT = "1"
"""Of metadata and attachments; the rows describe themselves."""
BLOCKS_TOPIC, CELL_TOPIC, MARKS_TOPIC = "/rows", "/cell", "/marks"
BLOCKS_SCHEMA, BLOCKS_ENCODING = "micromanip.Block", "micromanip.block"
ABOUT, END = "micromanip", "micromanip.end"
"""Metadata: what is recorded, written first; how it ended, written last and only where it was ended in order."""
BEGAN = "recording began"
"""The first mark."""
CONFIGURATION, STATE, SAMPLES = "configuration.yaml", "state.npy", "samples.npy"
PARAMETERS = "parameters-"
"""Attachments ``parameters-VERSION.npz``: the set that rows of a version ran with, the only array of it."""
STATES = "state-"
"""Attachments ``state-CYCLE.npy``: the loop's state at the end of a cycle on the way, from which a replay can begin."""


def sources_of_cycle() -> str:
    """What tells two versions of the cycle apart: a hash of all sources of `micromanip.rt`, 16 digits."""
    folder = Path(rt.__file__).parent
    hashed = hashlib.sha256()
    for source in sorted(folder.rglob("*.py")):
        hashed.update(source.read_bytes())
    return hashed.hexdigest()[:16]
