"""The tables of the compiled functions, filled from the PDOs of a configuration."""

from __future__ import annotations

from collections.abc import Sequence

from ..canbus.tables import Tables
from .pdos import ReceivedPdo, SentFrame
from .records import CONTEXT
from .sampling import SyncTimes


class PdoTables(Tables):
    """Those of a CANopen bus."""

    def __init__(
        self,
        received: Sequence[ReceivedPdo],
        sent: Sequence[SentFrame],
        watched: Sequence[int],
        syncs: SyncTimes,
        sync: tuple[int, int],
    ) -> None:
        """From now on all that is known of SYNCs and answers is kept in it.

        `watched` identifiers are Python's; `sync` is the task that sends it, -1 for none, and its time on the bus (ns).
        """
        super().__init__(CONTEXT, received, sent, False, [(identifier, False) for identifier in watched])
        self._c["sync_task"], self._c["sync_frame_ns"] = sync
        syncs.move_to(self._c["syncs"])
        for row, pdo in zip(self._c["sampling"], received, strict=False):
            pdo.sampling.move_to(row)

    def expect_heartbeats(self, overdue_ns: int) -> None:
        """From then on one is missing."""
        self._c["overdue_ns"] = overdue_ns
