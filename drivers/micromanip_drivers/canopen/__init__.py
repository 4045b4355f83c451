"""CANopen devices by their EDS files: process data by PDO, watched by heartbeats and emergency messages."""
