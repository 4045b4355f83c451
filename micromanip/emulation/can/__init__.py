"""Devices on CAN: frames of their own, and CANopen nodes."""
