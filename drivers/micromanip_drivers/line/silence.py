"""A device that should speak and doesn't: a half-open connection, a cable that was pulled, a device that hangs."""

from __future__ import annotations

from micromanip.driver import LinkError


class Silence:
    """Watches for `limit_ms` without anything that was understood, while something is expected."""

    def __init__(self, name: str, limit_ms: float) -> None:
        self._name = name
        self._limit_ns = round(limit_ms * 1e6)
        self._since_ns: int | None = None

    def expect(self, now_ns: int) -> None:
        """From now on it should speak, if it should not already."""
        if self._since_ns is None:
            self._since_ns = now_ns

    def heard(self, now_ns: int, more: bool) -> None:
        """It was understood; `more`: and should speak again without being asked."""
        self._since_ns = now_ns if more else None

    def check(self, now_ns: int) -> None:
        """Raises LinkError when it has been silent for too long."""
        if self._since_ns is not None and now_ns - self._since_ns > self._limit_ns:
            raise LinkError(f"{self._name}: nothing understood for {self._limit_ns * 1e-6:g} ms")
