"""Drivers that come with micromanip; the core finds them by entry point, like any other."""
