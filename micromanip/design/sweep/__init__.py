"""Thousands of drawn tunings over recordings: which would have held the path best."""
