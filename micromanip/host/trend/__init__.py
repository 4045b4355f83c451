"""Figures of each second and minute, to files that are kept for months."""
