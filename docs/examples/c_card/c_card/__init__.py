"""Example of a driver package whose functions come from a C library."""
