"""Learning from part to part: where memories are kept, how long a part is, and what may be played of them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from micromanip.control.learned import TOLERANCE_UM
from micromanip.quantities import Distance

from .base import Settings


class Learning(Settings):
    """What repeats of the path error over identical parts is learned after each, and played in the next.

    A part begins in the cycle in which the signal `part` says so; without that signal, where `learn part begin`
    was typed and the tracker has seen the path. Only what follows a tracker (`reference.source: signal`) learns.
    """

    folder: str | None = Field(
        default=None,
        min_length=1,
        description="Where the memories are, a file for each axis; relative to the configuration; null: `learned` in "
        "the state directory.",
    )
    seconds: Annotated[float, Field(strict=True, ge=2, le=120, allow_inf_nan=False)] = Field(
        description="How long a part takes, from its beginning; with `repeats` a period."
    )
    repeats: bool = Field(
        default=False,
        description="The path goes round and round without a stop, from the beginning of the part to its end: each "
        "period is learned from, and played to.",
    )
    limit_um: Annotated[float, Field(strict=True, gt=0, le=50, allow_inf_nan=False)] = Field(
        default=5.0, description="A correction that would be larger is not played."
    )
    tolerance_um: Distance = Field(
        default=TOLERANCE_UM,
        description="Where the reference is further from the remembered path, in any cycle, the correction fades out.",
    )
    temperature_K: Annotated[float, Field(strict=True, ge=0.5, le=50, allow_inf_nan=False)] = Field(
        default=2.0,
        description="With the signal `temperature`: what was learned further away than that is kept, and not played.",
    )
    search_s: Annotated[float, Field(strict=True, ge=0.05, le=2, allow_inf_nan=False)] = Field(
        default=0.3,
        description="Without the signal `part`: the path is looked for so far from where the command came.",
    )
