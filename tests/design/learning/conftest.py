"""One simulated cell for all: a part with noise, and the same without."""

import pytest

from micromanip.design.learning.parts import Cell
from micromanip.settings.check import prepare

from .played import CONFIG, SECONDS


@pytest.fixture(scope="package")
def prepared():
    return prepare(CONFIG)


@pytest.fixture(scope="package")
def cell(prepared):
    return Cell(prepared, SECONDS, 5.0)


@pytest.fixture(scope="package")
def noisy(cell):
    """Rows, and when the part begins in them."""
    return cell.make(1, {})


@pytest.fixture(scope="package")
def quiet(cell):
    return cell.make(None, {})
