"""Error frames as SocketCAN drivers make them (``linux/can/error.h``): how a client hears what its controller met."""

from __future__ import annotations

from enum import IntFlag

from .frame import Frame


class ErrorClass(IntFlag):
    """What an error frame is about: its identifier."""

    CONTROLLER = 0x004
    PROTOCOL = 0x008
    BUS_OFF = 0x040
    BUS_ERROR = 0x080
    RESTARTED = 0x100
    COUNTERS = 0x200


class Controller(IntFlag):
    """Status of the controller: data byte 1."""

    RX_OVERFLOW = 0x01
    RX_WARNING = 0x04
    TX_WARNING = 0x08
    RX_PASSIVE = 0x10
    TX_PASSIVE = 0x20
    ACTIVE = 0x40


_ON_TRANSMISSION = 0x80  # CAN_ERR_PROT_TX, data byte 2
_IN_CRC_SEQUENCE = 0x08  # CAN_ERR_PROT_LOC_CRC_SEQ, data byte 3


def controller_error(status: Controller, transmit_errors: int = 0, receive_errors: int = 0) -> Frame:
    """The controller's status changed; its error counters are told up to 255."""
    counters = bytes((min(transmit_errors, 255), min(receive_errors, 255)))
    return _error(ErrorClass.CONTROLLER | ErrorClass.COUNTERS, bytes((0, status, 0, 0, 0, 0)) + counters)


def bus_error(own: bool) -> Frame:
    """A frame was destroyed on the bus; `own` to the one who sent it."""
    data = bytes((0, 0, _ON_TRANSMISSION if own else 0, _IN_CRC_SEQUENCE, 0, 0, 0, 0))
    return _error(ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR, data)


def bus_off() -> Frame:
    """The controller took itself off the bus."""
    return _error(ErrorClass.BUS_OFF, bytes(8))


def restarted() -> Frame:
    """The controller takes part again, error-active."""
    return _error(ErrorClass.RESTARTED, bytes(8))


def _error(classes: ErrorClass, data: bytes) -> Frame:
    return Frame(int(classes), data, error=True)
