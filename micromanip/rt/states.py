"""States, commands and fault codes that the loop, the host and the clients share: plain integers."""

from __future__ import annotations

OFF, STARTING, READY, ARMED, TRACKING, HOLDING, RAMPING, FAULT = range(8)
STATE_NAMES = ("OFF", "STARTING", "READY", "ARMED", "TRACKING", "HOLDING", "RAMPING", "FAULT")

NO_COMMAND, ARM, DISARM, STOP, RESET = range(5)
COMMAND_NAMES = ("", "arm", "disarm", "stop", "reset")

NO_FAULT, HOST_DEAD, OVERRUNS, DRIVER_ERROR, STRAIN_INVALID, STAGE_INVALID, NOT_FINITE = range(7)

VOLTAGE, STRAIN, STAGE = range(3)
MODE_NAMES = ("voltage", "strain", "stage")
"""What an axis' reference is: a voltage (open loop), an actuator or a stage position."""
