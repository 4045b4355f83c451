"""What the stage of an axis sees of the motion of the others, and whether that is taken away ahead."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from .base import Flag, Settings

MOST = 0.5
"""Share of the others' motion, all together, with which a stage is still one whose axes are controlled one by one."""
Share = Annotated[float, Field(ge=-MOST, le=MOST)]


class Coupling(Settings):
    """Motion of this stage that comes of the others, as `commission` measures it with the strain loops closed."""

    share: dict[str, Share] = Field(
        default={}, description="Motion of this stage per motion of the named axis at rest, um/um."
    )
    decouple: Flag = Field(
        default=False,
        description="Compensate the coupling by feedforward from the other axes' references; in mode stage only from "
        "axes in mode stage. The margins stay the same.",
    )

    @model_validator(mode="after")
    def _is_small(self) -> Self:
        together = sum(abs(share) for share in self.share.values())
        if together > MOST:
            raise ValueError(f"share: {together:.3g} of the others' motion, at most {MOST:g} are bearable")
        return self
