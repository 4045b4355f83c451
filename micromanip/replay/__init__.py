"""A recorded run again: the very same compiled cycle on what its rows say came in."""

from .self_replay import Difference, Outcome, replay

__all__ = ["Difference", "Outcome", "replay"]
