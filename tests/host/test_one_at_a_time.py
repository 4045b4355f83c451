"""Where several workers run the tests, one of them has all whose real loop is judged."""

import os

import pytest


@pytest.mark.realtime
@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="all tests run in one process")
def test_loops_are_in_one_worker(request):
    """pytest 9.2 forgets the groups of pytest-xdist 3.8 without a word."""
    assert request.node.nodeid.endswith("@loop"), "run with --dist loadgroup, and a pytest that knows of it"
