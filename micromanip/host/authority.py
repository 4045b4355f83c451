"""Who may look at a running controller, and who may operate it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from enum import StrEnum

from micromanip.errors import PermissionDenied

from .peer import Peer


class Right(StrEnum):
    """What a verb takes: `OBSERVE` changes nothing, `OPERATE` moves something or changes what runs."""

    OBSERVE = "observe"
    OPERATE = "operate"


@dataclass(frozen=True)
class Authority:
    """Numbers of the groups whose members operate and observe; root and the controller's own user always do both."""

    operators: int
    observers: int | None = None

    def allows(self, peer: Peer, right: Right) -> bool:
        """Whoever operates may observe, too."""
        if peer.uid in (0, os.geteuid()) or self.operators in peer.groups:
            return True
        return right is Right.OBSERVE and self.observers in peer.groups

    def demand(self, peer: Peer, right: Right, verb: str) -> None:
        """Raise PermissionDenied where `peer` has not the `right` that `verb` takes."""
        if not self.allows(peer, right):
            may = "only observe" if self.allows(peer, Right.OBSERVE) else "do nothing here"
            raise PermissionDenied(
                f"{verb} refused: {peer.user} may {may}; to {right} takes to be in the group "
                f"that control.{right}_group names, at the time of connecting"
            )
