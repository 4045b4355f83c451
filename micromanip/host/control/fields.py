"""What each verb of the control socket is given."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from micromanip.host.recording.recording import Extent
from micromanip.quantities import Micrometres, Seed
from micromanip.rt.record import MAX_AXES
from micromanip.settings.excitation_plan import AMPLITUDE_UM
from micromanip.settings.move_plan import MoveRequest
from micromanip.settings.schema.base import Flag, Settings


class Nothing(Settings):
    """Fields of a verb that takes none."""


class Get(Settings):
    """Fields of `get`."""

    keys: tuple[str, ...] = Field(default=(), max_length=200, description="Keys or sections; all without one.")


class Set(Settings):
    """Fields of `set`."""

    changes: dict[str, Any] = Field(min_length=1, max_length=200, description="New values by key.")


class Save(Settings):
    """Fields of `save`."""

    force: Flag = Field(default=False, description="Write although the file was changed on disk.")


class JogTo(Settings):
    """Fields of `jog`."""

    axis: str = Field(description="Name of the axis.")
    by_um: Micrometres | None = Field(default=None, description="From its present target.")
    to_um: Micrometres | None = Field(default=None, description="Its new target.")

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.by_um is None) == (self.to_um is None):
            raise ValueError("give either by_um or to_um")
        return self


class Look(Settings):
    """Fields of `analyse_live` for a measurement that was begun."""

    number: Annotated[int, Field(strict=True, ge=1)] = Field(description="Which one is asked for.")


class Inject(Settings):
    """Fields of `analyse_live` that begin one."""

    axis: str = Field(description="Name of the axis.")
    loop: Literal["strain", "stage"] = Field(default="strain", description="Which of its loops.")
    amplitude_um: Annotated[float, Field(gt=0, le=10)] = Field(
        default=AMPLITUDE_UM,
        description="Rms of the multisine on the set-point.",
    )
    seed: Seed = Field(default=1, description="Draws its phases.")


class Moves(MoveRequest):
    """Fields of `move` that begin one."""

    axis: str = Field(description="Name of the axis.")


class MoveLook(Look):
    """Fields of `move` for one that was begun."""

    stop: Flag = Field(default=False, description="Let it come to rest.")


class Last(Settings):
    """Fields of `log`."""

    last: Annotated[int, Field(strict=True, ge=1, le=1000)] = Field(default=20, description="How many entries.")


class Forget(Settings):
    """Fields of `learn_reset`."""

    axes: tuple[str, ...] = Field(default=(), max_length=MAX_AXES, description="Of these axes; all without one.")


class RecordStart(Extent):
    """Fields of `recording_start`."""

    file: str | None = Field(default=None, description="Name in the folder of recordings; without one, the time.")


class RecordMark(Settings):
    """Fields of `recording_mark`."""

    text: str = Field(min_length=1, max_length=500, description="The remark.")
