"""Keys of the driver ``canopen``, in the words of ``config/canopen.yaml``; channels are called node.signal."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from micromanip.driver import Scaled, Section, Watchdog
from micromanip.driver.quantities import Latency, Real, SampleRate, Scale

from ..canbus.options import LinkOptions

_LONGEST_MS = 6_500
"""Without outputs for so long nothing is watched (``Watchdog``)."""
NodeId = Annotated[int, Field(strict=True, ge=1, le=127)]
Number = Annotated[int, Field(ge=1, le=512)]
Milliseconds = Annotated[int, Field(strict=True, ge=1, le=65535)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Word = Annotated[int, Field(strict=True, ge=0, le=0xFFFFFFFF)]
Transmission = Literal["sync", "event"] | Annotated[int, Field(strict=True, ge=1, le=240)]


class InputSignal(Scaled):
    """An object of a TPDO."""

    object: str | None = Field(
        default=None,
        description='Its name in the EDS, or its number there, "8130sub1"; null: the signal\'s own name.',
    )
    scale: Scale = Field(description="Physical unit per count: value = scale x number + offset.")


class OutputSignal(InputSignal):
    """An object of an RPDO."""

    safe: Real = Field(default=0.0, description="Value while the configuration does not use the output.")


class _Pdo(Section):
    rate_hz: SampleRate = Field(description="Rate, for the budgets of bus and loop.")
    transmission: Transmission | None = Field(
        default=None,
        description="sync: at each SYNC; a number n: at each n-th; event: by the sender's clock; null: as in the EDS.",
    )
    map: tuple[str, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=64,
        description="Objects in their order, written to the node at the start; null: as in the EDS.",
    )


class Tpdo(_Pdo):
    """A PDO from the node."""

    latency_us: Latency = Field(
        default=0.0, description="Age of a value in the device when it is sampled for the bus: filters, conversion."
    )
    signals: dict[Name, InputSignal] = Field(min_length=1, description="Signals by name; other objects are ignored.")


class Rpdo(_Pdo):
    """A PDO to the node."""

    latency_us: Latency = Field(default=0.0, description="From reception until the output acts.")
    signals: dict[Name, OutputSignal] = Field(
        min_length=1, description="Signals by name; every object of the PDO must be among them."
    )


class Identity(Section):
    """Expected content of object 0x1018; any other is the wrong device."""

    vendor_id: Word | None = Field(default=None, description="Vendor, 0x1018sub1.")
    product_code: Word | None = Field(default=None, description="Product, 0x1018sub2.")
    revision: Word | None = Field(default=None, description="Revision, 0x1018sub3.")
    serial: Word | None = Field(default=None, description="Serial number, 0x1018sub4.")


class NodeOptions(Section):
    """A device on the bus."""

    node_id: NodeId = Field(description="Number of the node on the bus.")
    eds: str = Field(min_length=1, description="EDS file, relative to the configuration.")
    heartbeat_ms: Annotated[int, Field(strict=True, ge=10, le=1500)] = Field(
        description="Longest silence of the node; then it is lost. The driver sets its heartbeat three times as fast.",
    )
    identity: Identity = Field(default=Identity(), description="Checked at the start; null keys are not.")
    tpdo: dict[Number, Tpdo] = Field(default={}, description="PDOs from the node, by number.")
    rpdo: dict[Number, Rpdo] = Field(default={}, description="PDOs to the node, by number.")
    watchdog_ms: Milliseconds | None = Field(
        default=None,
        description="Longest silence of the controller; then the node makes its outputs safe. Written at the start. "
        "null: no such watchdog, or one set up by other means.",
    )
    watchdog: Watchdog | None = Field(
        default=None, description="What the node does by itself, set up by other means; excludes watchdog_ms."
    )
    watchdog_by: Literal["rpdo", "heartbeat"] = Field(
        default="rpdo",
        description="Watched by the node: outputs (event timer of the RPDO, 0x1400sub5) or the controller's heartbeat "
        "(consumer heartbeat time, 0x1016sub1).",
    )

    @property
    def silence(self) -> Watchdog | None:
        """What it does without outputs. Of watchdog_ms nobody says what the node has when it is switched on.

        One that waits for the heartbeat tells by an emergency message that it has missed it.
        """
        if self.watchdog_ms is None or self.watchdog_ms > _LONGEST_MS or self.watchdog_by == "heartbeat":
            return self.watchdog
        return Watchdog(ms=self.watchdog_ms, after_power_on="unknown")

    @model_validator(mode="after")
    def _does_something(self) -> NodeOptions:
        if not self.tpdo and not self.rpdo:
            raise ValueError("a node needs a tpdo or an rpdo")
        if self.watchdog_ms is not None and not self.rpdo:
            raise ValueError("watchdog_ms is for outputs, and this node has no rpdo")
        if self.watchdog_ms is not None and self.watchdog is not None:
            raise ValueError("watchdog is for a watch that is set up by other means: leave it or watchdog_ms out")
        return self


class CanOpenOptions(LinkOptions):
    """A bus and its nodes."""

    sync_hz: SampleRate | None = Field(default=None, description="Rate of the controller's SYNC; null: none.")
    own_node_id: NodeId = Field(default=127, description="Number of the controller on the bus, in its heartbeat.")
    nodes: dict[Name, NodeOptions] = Field(min_length=1, description="Devices by name.")

    @model_validator(mode="after")
    def _is_classic(self) -> CanOpenOptions:
        if self.data_bitrate is not None:
            raise ValueError("CANopen is classic CAN: leave data_bitrate out")
        if self.bitrate > 1_000_000:
            raise ValueError(f"CANopen is classic CAN: {self.bitrate} bit/s is above its 1000000")
        return self

    @model_validator(mode="after")
    def _numbers_differ(self) -> CanOpenOptions:
        taken = {self.own_node_id: "own_node_id"}
        for name, node in self.nodes.items():
            if node.node_id in taken:
                raise ValueError(f"nodes.{name}.node_id: {node.node_id} is also that of {taken[node.node_id]}")
            taken[node.node_id] = name
        return self

    @property
    def heartbeat_period_ms(self) -> int | None:
        """Period of our own heartbeat, a third of the shortest time that a node waits for it; None if none does."""
        waiting = [n.watchdog_ms for n in self.nodes.values() if n.watchdog_ms and n.watchdog_by == "heartbeat"]
        return max(1, min(waiting) // 3) if waiting else None
