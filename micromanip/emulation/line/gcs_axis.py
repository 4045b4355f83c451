"""An axis of a GCS controller, with its piezo channel, and the errors that a command may be refused with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .device import Behind

UNKNOWN_COMMAND = 2
MOVE_WITHOUT_SERVO = 5
STOPPED = 10
INVALID_AXIS = 15
OUT_OF_RANGE = 17
WRONG_COUNT = 24
INVALID_NUMBER = 25
UNKNOWN_PARAMETER = 54
OPEN_LOOP_WHILE_SERVO_IS_ON = 79

_ON_TARGET = 0.05
_SERVO_GAIN = 0.02
"""What the servo adds to the open-loop value in a step, for each unit of position that is missing."""


class GcsRefusal(Exception):  # noqa: N818
    """A command that is not done, with the code that ``ERR?`` tells."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error {code}")
        self.code = code


@dataclass(frozen=True)
class Affine:
    """A channel of the driver, and what its numbers on the line mean: value = scale x number + offset."""

    channel: str
    scale: float = 1.0
    offset: float = 0.0

    def number(self, value: float) -> float:
        """On the line."""
        return (value - self.offset) / self.scale

    def value(self, number: float) -> float:
        """In the unit of the channel."""
        return self.scale * number + self.offset


class GcsAxis:
    """Moved in open loop, or by its own servo. Numbers are those on the line."""

    def __init__(
        self,
        name: str,
        behind: Behind,
        output: Affine | None,
        limits: tuple[float, float],
        sensors: Mapping[str, Affine],
    ) -> None:
        """`output` is None where nobody writes it; `limits` are its own; `sensors` are by command, POS? and TSP?."""
        self.name, self.output, self.limits, self.sensors = name, output, limits, dict(sensors)
        self.commanded, self.target, self.servo = 0.0, 0.0, False
        self._behind = behind

    @property
    def position(self) -> float:
        """Of the axis, as ``POS?`` tells it and its servo sees it; 0 without a sensor."""
        return self._read("POS?", "TSP?")

    @property
    def sensor_position(self) -> float:
        """Of its sensor channel, as ``TSP?`` tells it; the axis' own where it has but one."""
        return self._read("TSP?", "POS?")

    @property
    def voltage(self) -> float:
        """What its amplifier puts out."""
        return self.output.number(self._behind.voltage_V(self.output.channel)) if self.output else 0.0

    @property
    def on_target(self) -> bool:
        """Whether its servo has reached the target; an axis without servo is."""
        return not self.servo or abs(self.target - self.position) <= _ON_TARGET

    def check_open_loop(self, number: float) -> None:
        """Whether it may be put there now; raises GcsRefusal."""
        if self.servo:
            raise GcsRefusal(OPEN_LOOP_WHILE_SERVO_IS_ON)
        if not self.limits[0] <= number <= self.limits[1]:
            raise GcsRefusal(OUT_OF_RANGE)

    def check_target(self) -> None:
        """Whether its servo may be sent anywhere; raises GcsRefusal."""
        if not self.servo:
            raise GcsRefusal(MOVE_WITHOUT_SERVO)

    def switch_servo(self, on: bool) -> None:
        """On from where it stands, or off."""
        self.servo, self.target = on, self.position

    def servo_step(self) -> None:
        """A step of the servo's integrator."""
        low, high = self.limits
        self.commanded = min(max(self.commanded + _SERVO_GAIN * (self.target - self.position), low), high)

    def reboot(self) -> None:
        """As it is switched on."""
        self.commanded, self.target, self.servo = 0.0, 0.0, False

    def _read(self, command: str, other: str) -> float:
        sensor = self.sensors.get(command) or self.sensors.get(other)
        return sensor.number(self._behind.read(sensor.channel)) if sensor else 0.0
