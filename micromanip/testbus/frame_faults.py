"""Faults that strike frames: on the wire, or between the wire and who receives them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

from pydantic import Field, PrivateAttr

from .fault import Delivery, Disturbed, FrameFault, Share, Verdict


class Drop(FrameFault):
    """Frames go over the wire, but nobody gets them."""

    kind: Literal["drop"] = "drop"
    share: float = Share

    def through(self, delivery: Delivery) -> Iterable[Delivery]:
        return () if self._random.random() < self.share else (delivery,)


class Silence(FrameFault):
    """Nothing is delivered, as with a cut cable; the senders don't notice."""

    kind: Literal["silence"] = "silence"

    def through(self, delivery: Delivery) -> Iterable[Delivery]:  # noqa: ARG002
        return ()


class Delay(FrameFault):
    """Frames come late, in their order, as through a gateway."""

    kind: Literal["delay"] = "delay"
    delay_s: float = Field(default=0.0, ge=0, description="By how much at least.")
    jitter_s: float = Field(default=0.0, ge=0, description="By how much more at most, evenly distributed.")
    true_stamp: bool = Field(default=False, description="Stamped with their true time, as by an adapter with a clock.")

    def through(self, delivery: Delivery) -> Iterable[Delivery]:
        time_ns = delivery.time_ns + round((self.delay_s + self.jitter_s * self._random.random()) * 1e9)
        return (delivery._replace(time_ns=time_ns) if self.true_stamp else delivery.put_off(time_ns),)


class Reorder(FrameFault):
    """A frame is overtaken by the next one."""

    kind: Literal["reorder"] = "reorder"
    share: float = Share
    _held: Delivery | None = PrivateAttr(default=None)

    def through(self, delivery: Delivery) -> Iterable[Delivery]:
        if self._held is not None:
            overtaken, self._held = self._held, None
            return delivery, overtaken.put_off(delivery.time_ns)
        if self._random.random() < self.share:
            self._held = delivery
            return ()
        return (delivery,)

    def end(self, bus: Disturbed) -> None:
        if self._held is not None:
            bus.hand_over(self._held.put_off(bus.now_ns()))


class Burst(FrameFault):
    """Frames are held back for a time, then all come at once; over and over."""

    kind: Literal["burst"] = "burst"
    hold_s: float = Field(gt=0, description="How long the first of them is held back.")
    _release_ns: int = PrivateAttr(default=0)

    def through(self, delivery: Delivery) -> Iterable[Delivery]:
        if delivery.time_ns >= self._release_ns:
            self._release_ns = delivery.time_ns + round(self.hold_s * 1e9)
        return (delivery.put_off(self._release_ns),)


class Corrupt(FrameFault):
    """A bit is wrong: an error frame destroys the frame, error counters rise, and it is sent again."""

    kind: Literal["corrupt"] = "corrupt"
    share: float = Share

    def verdict(self) -> Verdict:
        return Verdict.DESTROYED if self._random.random() < self.share else Verdict.GOOD


class Duplicate(FrameFault):
    """The last bit is wrong for the sender only: it sends the frame again, and the others get it twice."""

    kind: Literal["duplicate"] = "duplicate"
    share: float = Share

    def verdict(self) -> Verdict:
        return Verdict.REPEATED if self._random.random() < self.share else Verdict.GOOD
