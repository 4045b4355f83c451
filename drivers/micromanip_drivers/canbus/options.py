"""Keys of the configuration: which CAN bus, whatever is spoken on it; those of the driver `canbus`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import can
from pydantic import Field, field_validator, model_validator

from micromanip.driver import BusOptions, Section, Watchdog, did_you_mean, real_because
from micromanip.driver.quantities import Latency, SampleRate

_WITHIN_THIS_MACHINE = ("micromanip", "virtual")
_OWN_KEYS = {"interface", "channel", "bitrate", "data_bitrate", "fd", "can_filters"}

Bitrate = Annotated[int, Field(strict=True, ge=5_000, le=20_000_000)]


class LinkOptions(BusOptions):
    """Which CAN bus; the model of a driver that speaks on one derives from it."""

    interface: str = Field(description="Interface of python-can: socketcan, pcan, kvaser, vector, slcan, gs_usb, ...")
    channel: Annotated[str, Field(strict=True)] | Annotated[int, Field(strict=True)] = Field(
        description="Channel of that interface, e.g. can0 (socketcan), PCAN_USBBUS1 (pcan), 0 (kvaser)."
    )
    bitrate: Bitrate = Field(
        description="Bits per second. With SocketCAN, which takes it from `ip link`, for the budget only."
    )
    data_bitrate: Bitrate | None = Field(
        default=None, description="Bits per second of the data phase; makes the bus CAN FD."
    )
    interface_options: dict[str, bool | int | float | str] = Field(
        default={}, description="Further options of python-can's interface (pcan: f_clock_mhz, ...)."
    )

    @field_validator("interface")
    @classmethod
    def _is_known(cls, interface: str) -> str:
        known = sorted(can.VALID_INTERFACES)
        if interface not in known:
            raise ValueError(f"python-can has no interface {interface}: {did_you_mean(interface, known)}")
        return interface

    @field_validator("interface_options")
    @classmethod
    def _leaves_our_keys(cls, given: dict[str, bool | int | float | str]) -> dict[str, bool | int | float | str]:
        if ours := sorted(_OWN_KEYS & set(given)):
            raise ValueError(f"{ours[0]} is not set here: interface, channel, bitrate and data_bitrate stand beside it")
        return given

    @model_validator(mode="after")
    def _data_is_not_slower(self) -> LinkOptions:
        if self.data_bitrate is not None and self.data_bitrate < self.bitrate:
            raise ValueError(f"data_bitrate {self.data_bitrate} is below bitrate {self.bitrate}: CAN FD data is faster")
        return self

    @classmethod
    def of(cls, section: Mapping[str, Any]) -> LinkOptions:
        """Of a driver's section, whatever else is in it. Raises ValidationError."""
        return cls.model_validate({key: value for key, value in section.items() if key in LinkOptions.model_fields})

    @property
    def fd(self) -> bool:
        """True for a CAN FD bus."""
        return self.data_bitrate is not None

    @property
    def device(self) -> str:
        """The bus by name, e.g. "socketcan-can0"; the port of an adapter that is one, e.g. "/dev/ttyACM0"."""
        channel = str(self.channel)
        return channel.partition("@")[0] if channel.startswith("/") else f"{self.interface}-{channel}"

    @property
    def real_because(self) -> str | None:
        """As of ``BusDriver``."""
        if self.interface in _WITHIN_THIS_MACHINE:
            return None
        if self.interface == "socketcan" or self.device.startswith("/"):
            return real_because(self.device)
        return f"python-can's interface {self.interface} leads out of this machine"


Milliseconds = Annotated[int, Field(strict=True, ge=10, le=60_000)]


class Status(Section):
    """A signal that marks the device's message as valid."""

    signal: str = Field(description="Name of the signal, unsigned.")
    good: tuple[Annotated[int, Field(strict=True, ge=0)], ...] = Field(
        default=(0,), description="Values that mean good."
    )


class Received(Section):
    """A message from a device."""

    rate_hz: SampleRate = Field(description="Rate at which the device sends it.")
    counter: str | None = Field(
        default=None,
        description="Signal that the device increments with each frame: gaps count, repeated frames are not fresh.",
    )
    latency_us: Latency | None = Field(
        default=None,
        description="From measurement to the end of the frame; null: the frame's longest time.",
    )
    status: Status | None = None


class Sent(Section):
    """A message to a device, at a fixed rate, with the latest values."""

    rate_hz: SampleRate = Field(description="Rate at which it is sent.")
    counter: str | None = Field(default=None, description="Signal that the driver increments with each frame.")
    latency_us: Latency | None = Field(
        default=None, description="From sending until the value acts; null: the frame's longest time."
    )


class CanBusOptions(LinkOptions):
    """Frames described by a DBC file."""

    database: str = Field(description="DBC file, relative to the configuration.")
    receive: dict[str, Received] = Field(default={}, description="Messages from devices, by name in the DBC.")
    send: dict[str, Sent] = Field(default={}, description="Messages to devices, by name in the DBC.")
    silence_ms: Milliseconds | None = Field(
        default=500,
        description="Longest silence of `receive`; then the link is lost until the next frame. null: no limit, for "
        "devices that send rarely or on request only.",
    )
    watchdog: Watchdog | None = Field(default=None, description="What the device does by itself; null: nobody knows.")

    @model_validator(mode="after")
    def _silence_is_unusual(self) -> CanBusOptions:
        fastest_hz = max((received.rate_hz for received in self.receive.values()), default=None)
        if self.silence_ms is not None and fastest_hz is not None and self.silence_ms * 1e-3 * fastest_hz < 3.0:
            raise ValueError(
                f"silence_ms {self.silence_ms} is less than three periods of what comes most often "
                f"({fastest_hz:g} Hz): make it longer, or null"
            )
        return self
