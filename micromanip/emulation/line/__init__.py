"""Devices on lines of their own: serial, TCP or UDP; text, binary frames or streams of samples."""
