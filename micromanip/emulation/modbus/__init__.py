"""Modbus units, on a serial line or behind a TCP address."""
