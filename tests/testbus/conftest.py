import pytest

from .virtual_bus import VirtualBus


@pytest.fixture
def make_bus(closing):
    """A virtual bus with the given bit rates and options; closed after the test."""
    return lambda *args, **options: closing(VirtualBus(*args, **options))


@pytest.fixture
def bus(make_bus):
    """A classic bus of 1 Mbit/s: one bit takes a microsecond."""
    return make_bus()
