"""Memory that can't be had is told as that, with the limit that may forbid it, and nothing of it is kept."""

import resource
from pathlib import Path

import pytest

from micromanip.errors import DeviceUnavailable
from micromanip.host.shared_memory import Segment


def descriptors():
    return {path.name for path in Path("/proc/self/fd").iterdir()}


def test_what_can_t_be_had_is_told_with_its_size_and_name():
    before, opened = resource.getrlimit(resource.RLIMIT_FSIZE), descriptors()
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, before[1]))
    try:
        with pytest.raises(DeviceUnavailable, match=r"^2500 MB of memory for micromanip-ring: .*; a limit .*LimitAS$"):
            Segment.create("micromanip-ring", 2_500_000_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert descriptors() == opened
