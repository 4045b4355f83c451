"""A cyclic driver from a C library: Python only describes it, the loop calls the C functions themselves."""

import ctypes
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from micromanip.driver import ConfigError, CyclicDriver, Functions

CONTEXT = np.dtype([("um_per_V", "f8"), ("output_V", "f8"), ("is_open", "i8")], align=True)


class CardOptions(BaseModel):
    """Keys of this driver in the configuration."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    library: str = Field(description="The shared library, seen from where the controller is started.")
    um_per_V: float = Field(default=0.9, gt=0, description="Scale of the input.")


class Card(CyclicDriver):
    """The functions of `card.c`."""

    Options = CardOptions
    watchdog = "the card's own: outputs to 0 V after 5 ms without an exchange"
    inputs = ("strain",)
    outputs = ("voltage",)

    def __init__(self, options, period_ns):
        self.options, self.period_ns = options, period_ns
        self.library = Path(options.library).resolve()
        if not self.library.is_file():
            raise ConfigError(f"library: {self.library} is not there; compile it first")

    def context(self):
        context = np.zeros(1, CONTEXT)
        context["um_per_V"] = self.options.um_per_V
        return context.view(np.uint8)

    def functions(self):
        library = ctypes.CDLL(str(self.library))

        def address(name):
            return ctypes.cast(getattr(library, name), ctypes.c_void_p).value

        return Functions(*(address(f"card_{verb}") for verb in ("open", "exchange", "safe", "close")))
