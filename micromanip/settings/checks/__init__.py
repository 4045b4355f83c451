"""Checks beyond the schema: each file finds what is impossible or unwise in one respect."""
