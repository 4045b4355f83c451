"""Cases of a parametrised test for `make thorough` only."""

import pytest


def further(*cases):
    """`cases`, a value or a tuple of values each, marked thorough: more of what the cases beside them show."""
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.thorough) for case in cases]
