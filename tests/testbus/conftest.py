import pytest

from .virtual_bus import VirtualBus


@pytest.fixture
def make_bus():
    """A virtual bus with the given bit rates and options; closed after the test."""
    made = []

    def make(*args, **options):
        made.append(VirtualBus(*args, **options))
        return made[-1]

    yield make
    for bus in made:
        bus.close()


@pytest.fixture
def bus(make_bus):
    """A classic bus of 1 Mbit/s: one bit takes a microsecond."""
    return make_bus()
