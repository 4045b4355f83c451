"""Learning from part to part: where memories are kept, how long a part is, and what may be played of them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from micromanip.quantities import Distance

from .base import Settings


class Learning(Settings):
    """What repeats of the path error over identical parts is learned after each, and played in the next.

    A part begins in the cycle in which the signal `part` says so; without that signal, in which the loop takes
    `micromanip learn part begin`. Only what follows a tracker (`reference.source: signal`) learns.
    """

    folder: str | None = Field(
        default=None,
        min_length=1,
        description="Folder of the memories, a file for each axis, relative to the configuration; null: `learned` in "
        "the state directory.",
    )
    seconds: Annotated[float, Field(strict=True, ge=2, le=120, allow_inf_nan=False)] = Field(
        description="Duration of a part."
    )
    limit_um: Annotated[float, Field(strict=True, gt=0, le=50, allow_inf_nan=False)] = Field(
        default=5.0, description="Largest correction; a larger one is not played."
    )
    tolerance_um: Distance = Field(
        default=5.0,
        description="Largest distance of the reference from the remembered path in any cycle; beyond it the "
        "correction fades out.",
    )
    temperature_K: Annotated[float, Field(strict=True, ge=0.5, le=50, allow_inf_nan=False)] = Field(
        default=2.0,
        description="Largest difference of the signal `temperature` from that of the memory; beyond it the memory is "
        "kept but not played.",
    )
