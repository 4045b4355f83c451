"""What tests of the gateway share."""

import pytest


@pytest.fixture
def closing():
    """What is appended is closed, the last one first."""
    open_ones = []
    yield open_ones
    for one in reversed(open_ones):
        one.close()
