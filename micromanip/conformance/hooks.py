"""What a subclass of the suite fills in, and how the checks use it."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import pytest

from micromanip.bus.driver import BusDriver
from micromanip.bus.errors import BusError

from .peer import Golden, Peer
from .session import Session


class Hooks:
    """`driver` and `peer` must be given; the more of the others, the more is checked."""

    driver: type[BusDriver]
    """The driver's class; in a module that a new process can import."""

    folder: Path = Path()
    """Where the names of files in its options are seen from."""

    golden_inputs: Sequence[Golden] = ()
    golden_outputs: Sequence[Golden] = ()
    """At least two; the first two differ in every output. They serve as "old" and "new" value too."""

    wrong_identity: Mapping[str, Any] = {}
    """Options that name another device than the peer."""

    out_of_range: Sequence[float] = (1e300, -1e300)
    """Finite values that no output can carry; the nearest to the range find the most."""

    checksummed: bool = True
    """Whether the driver must find out one wrong bit in a golden input. False where the bus itself does (CAN)."""

    tolerance: float = 1e-6
    """Relative error of a value that went over the wire."""

    stale_writes: int = 10
    """How many old writes may still arrive after a newer one was given: what the bus itself holds on the way."""

    patience_s: ClassVar[float] = 0.5
    """A call may be so late on a busy machine; what is looked for are calls that block for longer."""

    kills: ClassVar[int] = 5

    def peer(self) -> Peer:
        """A device of your own, not started yet."""
        raise AssertionError(f"{type(self).__name__} must give peer(): a device to talk to")

    def garbage(self) -> Sequence[bytes]:
        """Units that hold nothing: random bytes, and golden inputs with one wrong bit."""
        draw = random.Random(20)
        blocks = [draw.randbytes(draw.randint(1, 64)) for _ in range(60)]
        wires = [wire for golden in self.golden_inputs for wire in golden.wire] if self.checksummed else []
        return blocks + [_flipped(wire, draw.randrange(8 * len(wire))) for wire in wires for _ in range(20)]

    def partial(self) -> Sequence[bytes]:
        """Golden inputs that end too early."""
        return [wire[:end] for golden in self.golden_inputs for wire in golden.wire for end in range(1, len(wire))]

    def make(self, peer: Peer, **changed: Any) -> BusDriver:
        """The driver for this peer, not opened; `changed` replaces some of its options."""
        options = self.driver.Options.model_validate({**peer.options, **changed})
        return self.driver(options, self.folder)

    @contextmanager
    def device(self) -> Iterator[Peer]:
        """A peer that runs."""
        peer = self.peer()
        peer.start()
        try:
            yield peer
        finally:
            peer.kill()

    @contextmanager
    def running(self) -> Iterator[tuple[Peer, Session]]:
        """A peer that runs, and the driver opened on it."""
        with self.device() as peer, Session(self.make(peer)) as session:
            yield peer, session

    def patterns(self) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """An old and a new value for each output."""
        if not self.make(self.peer()).outputs:
            pytest.skip("the driver has no outputs")
        if len(self.golden_outputs) < 2:
            pytest.skip("golden_outputs: two are needed, as an old and a new value for each output")
        old, new = (golden.values for golden in self.golden_outputs[:2])
        same = [name for name in old if self.equal(old[name], new.get(name, old[name]))]
        assert not same, f"golden_outputs: the first two must differ in every output, not so in {', '.join(same)}"
        return old, new

    def ordered(self, values: Mapping[str, float]) -> list[float]:
        """Values of the outputs in the driver's order."""
        return [values[channel.name] for channel in self.make(self.peer()).outputs]

    def equal(self, value: float, wanted: float) -> bool:
        """Whether they are the same, but for rounding."""
        return math.isclose(value, wanted, rel_tol=self.tolerance, abs_tol=self.tolerance * 1e-3)


def settle(condition: Any, seconds: float = 5.0) -> bool:
    """Wait until `condition()` holds, for so long at most."""
    end = time.monotonic() + seconds
    while not (reached := bool(condition())) and time.monotonic() < end:
        time.sleep(0.005)
    return reached


def errors_text(errors: Sequence[BusError]) -> str:
    """Errors for a message."""
    return "; ".join(f"{type(error).__name__}: {error}" for error in errors[:3]) or "none"


def _flipped(wire: bytes, bit: int) -> bytes:
    return bytes(byte ^ (1 << bit % 8 if place == bit // 8 else 0) for place, byte in enumerate(wire))
