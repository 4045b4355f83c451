"""The counter that a device puts into its packets, also where a packet holds many samples."""

from __future__ import annotations

from ..canbus.frame_counter import FrameCounter
from .field_options import Number
from .number import NumberCodec


class PacketCounter:
    """Counts samples that are missing; `by_sample`: the number is that of the packet's first sample."""

    def __init__(self, options: Number, by_sample: bool = False) -> None:
        self._codec = NumberCodec(options)
        self._by_sample = by_sample
        self._frames = FrameCounter(8 * options.size)
        self._counts = self._codec.counts
        self.lost = 0

    def forget(self) -> None:
        """Begin anew: what comes next is taken as it is."""
        self._frames.forget()

    @property
    def stale(self) -> int:
        """Packets that were no news: repeated, or overtaken on their way."""
        return self._frames.repeated + self._frames.out_of_order

    def lost_before(self, packet: bytes, samples: int = 1) -> int | None:
        """Samples known to be missing before those of `packet`; None for a packet that is not fresh."""
        count = int(self._codec.read(packet))
        if not self._by_sample:
            packets = self._frames.lost_before(count)
            lost = None if packets is None else packets * samples
        else:
            between = self._frames.lost_before((count + samples - 1) % self._counts)  # of the last samples
            if between is None:
                return None
            lost = max(0, between - (samples - 1))
        self.lost += lost or 0
        return lost
