"""A real loop whose values are changed while it tracks, by the commands and by SIGHUP."""

import json
import signal
import subprocess
import time

import numpy as np
import pytest
from click.testing import CliRunner

from campaigns.running_controller import MICROMANIP, until
from micromanip.cli.main import cli
from micromanip.client import Client
from micromanip.errors import UsageError
from micromanip.rt import mailbox as w
from micromanip.rt.states import TRACKING
from tests.cells import calm, rows_of

from .whole_module import tracking_until_the_end

pytestmark = pytest.mark.live  # a running controller

K = "axes.x.inner.K_V_per_um"


@pytest.fixture(scope="module")
def tracking(tmp_path_factory):
    with tracking_until_the_end(tmp_path_factory.mktemp("live"), calm()) as cell:
        yield cell


@pytest.fixture
def cell(tracking):
    """A controller that tracks; after each test it still does."""
    yield tracking
    tracking.go_on(200)
    assert tracking.state == "TRACKING"


@pytest.fixture
def client(cell):
    with Client(cell.socket) as client:
        yield client


def command(cell, *arguments):
    """What a command prints."""
    result = CliRunner().invoke(cli, [*arguments, "--socket", str(cell.socket)], catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def version(cell):
    return int(cell.status["words"][w.VERSION_ACTIVE])


def test_a_set_is_one_swap(cell, client):
    """Telemetry shows one change of version, and the loop has all of the new values from there on."""
    before = version(cell)
    swap = client.set({K: 0.55, "axes.y.inner.K_V_per_um": 0.5, "axes.z.inner.Ti_ms": 0.6})
    assert swap["version"] == before + 1
    assert len(swap["changed"]) == 3
    cell.go_on(200)
    rows = rows_of(cell.ring)[-20_000:]  # the oldest ones are being overwritten
    steps = np.diff(rows["version"])
    assert np.count_nonzero(steps) == 1
    assert steps.max() == 1
    slot = cell.control["parameters"][int(cell.control["words"][w.SLOT])]
    assert list(slot["axis"]["pid"]["K_V_per_um"]) == [0.55, 0.5, 0.6]
    assert client.value(K) == 0.55


def test_hang_up_reloads(cell, client):
    """SIGHUP to a service takes over its file; a file that needs more than a swap is refused, and says so."""
    text = cell.config.read_text()
    before = version(cell)
    cell.config.write_text(text.replace("Td_ms: 0.167", "Td_ms: 0.15"))
    cell.process.send_signal(signal.SIGHUP)
    until(lambda: "reloaded, changed: " in cell.said, cell.last_words)
    assert version(cell) == before + 1
    assert client.value("axes.z.inner.Td_ms") == 0.15
    cell.config.write_text(text.replace("rate_hz: 10000", "rate_hz: 5000"))
    cell.process.send_signal(signal.SIGHUP)
    until(lambda: "WARNING: reload refused: " in cell.said, cell.last_words)
    assert "loop.rate_hz needs restart" in cell.said
    assert version(cell) == before + 1
    entries = client.log()["entries"]
    assert [e["accepted"] for e in entries if e["user"] == "SIGHUP"] == [True, False]


def test_commands(cell):
    old = json.loads(command(cell, "get", K, "--json"))[0]["value"]
    assert command(cell, "set", f"{K}=0.52").endswith(f"\n  {K}: {old} -> 0.52\n")
    assert json.loads(command(cell, "get", K, "--json")) == [{"key": K, "value": 0.52, "change": "live"}]
    assert command(cell, "get", K) == f"live  {K}=0.52\n"
    assert "running 0.52\n" in command(cell, "diff")
    assert "written\n" in command(cell, "save", "--force")
    assert command(cell, "diff").endswith("  says what runs\n")
    assert command(cell, "reload") == "nothing to change\n"
    told = command(cell, "log", "--last", "3")
    assert [line.split()[-1] for line in told.splitlines() if not line.startswith(" ")] == ["set", "save", "reload"]
    entries = json.loads(command(cell, "log", "--json"))["entries"]
    assert entries[0]["verb"] == "arm"
    assert entries[0]["user"] == "configuration"


def watched(cell, lines, *arguments):
    """The first lines of the stream; who reads no more ends it, which is no failure."""
    watch = [str(MICROMANIP), "get", "--watch", *arguments, "--socket", str(cell.socket)]
    with subprocess.Popen(watch, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        read = [process.stdout.readline()]
        process.send_signal(signal.SIGSTOP)  # as on a busy machine
        time.sleep(0.1)
        process.send_signal(signal.SIGCONT)
        read += [process.stdout.readline() for _ in range(lines - 1)]
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == ("", 0)
    return read


def test_values_of_the_loop_are_streamed_a_line_a_sample(cell):
    samples = [json.loads(line) for line in watched(cell, 4, "x.strain_um", "voltage_V", "--every", "0.01", "--json")]
    assert all(set(sample) == {"t_s", "x.strain_um", *(f"{axis}.voltage_V" for axis in "xyz")} for sample in samples)
    assert (np.diff([sample["t_s"] for sample in samples]) > 0.0).all()
    assert all(30.0 < sample["x.strain_um"] < 100.0 for sample in samples)
    head, row = watched(cell, 2, "state")
    assert head.split() == ["t_s", "state"]
    assert row.split()[1] == str(TRACKING)


def test_a_value_that_is_not_there_is_named(cell):
    with pytest.raises(UsageError, match=r"there is no value 'x.strian_um' to watch; did you mean x.strain_um\?"):
        command(cell, "get", "--watch", "x.strian_um")
