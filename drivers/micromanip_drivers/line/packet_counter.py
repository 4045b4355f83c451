"""The counter of a device's packets: which are fresh, and how many samples are missing."""

from __future__ import annotations

from micromanip.driver.wire import DeviceCounter, NumberCodec

from .frame_options import Number


class PacketCounter(DeviceCounter):
    """`by_sample`: the number is that of the packet's first sample, else that of the packet."""

    def __init__(self, options: Number, by_sample: bool = False) -> None:
        super().__init__(8 * options.size)
        self._codec, self.by_sample = NumberCodec(options), by_sample
        self._more = 0

    def samples_before(self, packet: bytes, samples: int = 1) -> int | None:
        """Samples known to be missing before the `samples` of a packet; None for a packet that is not fresh."""
        missing = self.lost_before(int(self._codec.read(packet)), samples if self.by_sample else 1)
        if missing is None or self.by_sample:
            return missing
        self._more += missing * (samples - 1)
        return missing * samples

    @property
    def lost(self) -> int:
        """Samples that are known to be missing, up to now."""
        return self.counted("lost") + self._more

    @property
    def stale(self) -> int:
        """Packets that were not fresh."""
        return self.counted("doubled") + self.counted("late")

    @property
    def restarts(self) -> int:
        """How often the device began anew."""
        return self.counted("restarts")
