"""Example of a driver package: a stage that exists in memory only."""
