"""What every injected fault has: how long it lasts, which frames it strikes, and where it takes hold of the bus."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import Enum
from random import Random
from typing import NamedTuple, Protocol, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, TypeAdapter, ValidationError

from micromanip.errors import UsageError

from .client_port import ClientPort
from .frame import Frame
from .port import Port, Transmission

_Fault = TypeVar("_Fault")

Share = Field(default=1.0, gt=0, le=1, description="Share of the frames that it strikes, at random.")


class Verdict(Enum):
    """What becomes of a frame at its end."""

    GOOD = "arrives"
    DESTROYED = "an error frame destroys it, and it is sent again"
    REPEATED = "arrives, but its sender believes that it didn't, and sends it again"


class Delivery(NamedTuple):
    """A frame on its way from the wire to the receivers."""

    time_ns: int
    """When they get it."""
    stamp_ns: int
    """When it ended, as they are told."""
    sender: Port
    transmission: Transmission

    def put_off(self, time_ns: int) -> Delivery:
        """The same at `time_ns`; it is stamped so, unless its stamp is none of the time when it comes."""
        stamp_ns = time_ns if self.stamp_ns == self.time_ns else self.stamp_ns
        return self._replace(time_ns=time_ns, stamp_ns=stamp_ns)


class Disturbed(Protocol):
    """The bus, as far as a fault takes hold of it."""

    @property
    def clients(self) -> Iterator[ClientPort]:
        """Those that are connected from other processes."""

    def now_ns(self) -> int:
        """The time of the bus's clock."""

    def transmission(self, frame: Frame) -> Transmission:
        """A frame for the queue of a participant of one's own making, as of now."""

    def join(self, port: Port) -> None:
        """Let any kind of participant take part."""

    def leave(self, port: Port) -> None:
        """Take a participant off the bus; does no harm twice."""

    def hand_over(self, delivery: Delivery) -> None:
        """Give a frame that was held back to all but its sender."""


class Fault(BaseModel):
    """A fault; what a kind doesn't redefine goes as it does on a healthy bus."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    kind: str
    for_s: float | None = Field(default=None, gt=0, description="How long it lasts; null: until it is cleared.")

    def begin(self, bus: Disturbed) -> None:
        """Take hold of the bus. Raises UsageError for what the bus hasn't got."""

    def end(self, bus: Disturbed) -> None:
        """Let the bus be."""


class FrameFault(Fault):
    """A fault that strikes single frames."""

    identifier: int | None = Field(default=None, ge=0, le=0x1FFF_FFFF, description="Only this one; null: all.")
    _random: Random = PrivateAttr(default_factory=Random)

    def strikes(self, transmission: Transmission) -> bool:
        """Whether the frame is one of those that are meant."""
        return self.identifier is None or self.identifier == transmission.frame.identifier

    def draw_from(self, random: Random) -> None:
        """Use this source of chance."""
        self._random = random

    def verdict(self) -> Verdict:
        """What becomes of a frame on the wire."""
        return Verdict.GOOD

    def through(self, delivery: Delivery) -> Iterable[Delivery]:
        """What the receivers get in place of `delivery`."""
        return (delivery,)


class ClientFault(Fault):
    """A fault of the controllers of clients: those that are connected when it begins."""

    client: int | None = Field(default=None, gt=0, description="Process id of the client; null: all.")

    def struck(self, bus: Disturbed) -> Iterator[ClientPort]:
        """Those that are still there."""
        return (port for port in bus.clients if self.client in (None, port.process_id))


def validated(kinds: TypeAdapter[_Fault], document: object) -> _Fault:
    """The fault among `kinds` that `document` describes. Raises UsageError with the first thing that is wrong."""
    try:
        return kinds.validate_python(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = " ".join(str(part) for part in first["loc"])
        raise UsageError(f"fault{f' {where}' if where else ''}: {first['msg']}") from error
