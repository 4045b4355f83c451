"""Identification, synthesis and evaluation: plain functions on arrays, offline."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .linear import LinearFit, fit_linear

__all__ = ["LinearFit", "fit_linear"]


def __getattr__(name: str) -> Any:
    """Looked up when it is asked for (PEP 562): the half of scipy that it takes is not for all who read a report."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import linear

    return getattr(linear, name)
