"""Whether a memory is one of a running cell: of its axes as they are tuned, and of its parts."""

from __future__ import annotations

from pathlib import Path

from micromanip.errors import CheckFailed, MicromanipError
from micromanip.settings.commissioned import tuning_hash
from micromanip.settings.schema.model import Configuration

from .memory import Memory, cell_name, memory_files, read_memory

_CYCLES = 2.0
"""A memory has a value in several cycles: its part is that long to a value or two."""


def require_usable(memory: Memory, configuration: Configuration, name: str, file: Path) -> None:
    """Raise CheckFailed where `memory`, in `file`, is not of this cell's axis `name`, as it is tuned, and its parts."""
    memory.require(cell_name(configuration), name, tuning_hash(configuration.axes[name]), str(file))
    learning = configuration.learning
    assert learning is not None
    if memory.repeats != learning.repeats:
        which = ("of a part with an end", "of a path that repeats")
        raise CheckFailed(
            f"{file}: this memory is {which[memory.repeats]}, learning.repeats says {str(learning.repeats).lower()}: "
            "learn anew, after `micromanip learn reset`"
        )
    if abs(memory.seconds - learning.seconds) * memory.rate_hz > _CYCLES:
        raise CheckFailed(
            f"{file}: this memory is of a part of {memory.seconds:g} s, learning.seconds says {learning.seconds:g}: "
            "learn anew, after `micromanip learn reset`"
        )


def memory_warnings(configuration: Configuration, folder: Path) -> list[str]:
    """A sentence for each memory in `folder` that `run` would not use; an axis that has none yet is not missed."""
    found = []
    for name in configuration.axes:
        for file in memory_files(folder, name):
            try:
                memory = read_memory(file)
                if memory is not None:
                    require_usable(memory, configuration, name, file)
            except MicromanipError as problem:
                found.append(f"{problem}; nothing would be learned or played of axis {name}")
    return found
