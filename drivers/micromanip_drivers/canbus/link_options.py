"""Keys of the configuration that say which CAN bus, whatever is spoken on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import can
from pydantic import Field, field_validator, model_validator

from micromanip.driver import BusOptions, did_you_mean, real_because

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
