"""The device of a driver `udp`."""
