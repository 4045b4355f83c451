"""The descriptors that compiled code waits for in the event loop's stead, as ``ppoll`` wants them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from micromanip.rt.io.sockets import POLLIN


class PollTable:
    """Rows of descriptor and events, made anew only when the descriptors are others."""

    def __init__(self) -> None:
        self._rows = np.zeros((0, 2), np.int32)

    def of(self, descriptors: Sequence[int]) -> Any:
        """Table (n, 2) of these."""
        if len(descriptors) != len(self._rows) or not np.array_equal(self._rows[:, 0], descriptors):
            self._rows = np.array([(each, POLLIN) for each in descriptors], np.int32).reshape(-1, 2)
        return self._rows
