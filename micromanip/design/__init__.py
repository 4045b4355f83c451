"""Identification, synthesis and evaluation: plain functions on arrays, offline."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .data import load_record
    from .identify.fitting import Request, fit_record
    from .identify.linear import LinearFit, fit_linear
    from .identify.linear.configured import per_cycle
    from .identify.linear.experiments import load_linear
    from .identify.linear.validated import fit_records
    from .synthesise import tune_outer

_PLACES = {"Request": "fitting", "fit_record": "fitting", "LinearFit": "linear", "fit_linear": "linear"}
_PLACES |= {"per_cycle": "linear.configured", "load_linear": "linear.experiments", "fit_records": "linear.validated"}
_PLACES = {name: f"identify.{place}" for name, place in _PLACES.items()}
_PLACES |= {"load_record": "data", "tune_outer": "synthesise"}

__all__ = [
    "LinearFit", "Request", "fit_linear", "fit_record", "fit_records", "load_linear", "load_record", "per_cycle",
    "tune_outer",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Looked up when it is asked for (PEP 562): the half of scipy that it takes is not for all who read a report."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_PLACES[name]}", __name__), name)
