"""Each test gets controllers of its own, and must leave nothing of them behind."""

import gc
import socket
from contextlib import suppress
from pathlib import Path

import pytest

from campaigns.running_controller import Running, command_line, until


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist looks for the groups
def pytest_collection_modifyitems(items):
    """Who starts a controller is live; where its loop is judged, one worker has them all, one at a time."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            if "run" in item.fixturenames:
                item.add_marker("live")
            if "realtime" in item.keywords:
                item.add_marker(pytest.mark.xdist_group("loop"))


def memory_files():
    """Descriptors of this process on a controller's shared memory."""
    links = [str(entry.readlink()) for entry in Path("/proc/self/fd").iterdir() if entry.is_symlink()]
    return sorted(link for link in links if link.startswith("/memfd:micromanip-"))


@pytest.fixture
def run(tmp_path):
    """Starts a controller: ``run(text, "--duration", "3")``."""
    before = memory_files()
    started = []

    def start(text, *arguments, **options):
        started.append(Running(tmp_path, text, *arguments, **options))
        return started[-1]

    yield start
    ended = [each.process.poll() is not None for each in started]
    left = [{pid: command_line(pid) for pid in each.kill()} for each in started]
    for each in started:
        each.release()
    assert all(ended), f"the test left a host running: {left}"
    assert not any(left), f"processes left behind: {left}"
    until(lambda: not any(each.socket.exists() for each in started), "a control socket is left behind", 5.0)
    if len(memory_files()) > len(before):
        gc.collect()
    assert len(memory_files()) <= len(before)


@pytest.fixture
def kills(request):
    """How often a recorder is killed: three times, or as the campaign `recorder` says."""
    return request.config.getoption("--kills")


@pytest.fixture
def manager(tmp_path):
    """A service manager's socket; ``heard()`` is every message so far."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        messages = []

        def heard():
            with suppress(BlockingIOError):
                while True:
                    messages.append(listener.recv(4096).decode())
            return messages

        heard.path = listener.getsockname()
        yield heard
