"""Figures of recorded runs against closed forms; confidence that is what it says, with correlated samples too."""

import json

import numpy as np
import pytest
from cli.command import code_of
from host.test_mcap_recording import CONFIGURATION as CONFIGURATION_IN_FILE
from host.test_mcap_recording import begun, slots, some_rows
from hypothesis import given
from hypothesis import strategies as st
from recordings.damaged import damage
from scipy.signal import lfilter, welch

from micromanip.design.run import comparison
from micromanip.design.run.comparison import configuration_changes, ratio, run_figures
from micromanip.design.run.statistics import RecordedRun
from micromanip.design.run.sums import Counts, Sections, Spectra
from micromanip.errors import CheckFailed
from micromanip.faults import KINDS
from micromanip.recordings import open_telemetry
from micromanip.rt.states import TRACKING
from tests.design.commission.test_report import Page


def correlated(count, memory, seed):
    """A first-order process with unit variance; `memory` is the correlation of neighbours."""
    noise = np.random.default_rng(seed).standard_normal(count + 5000)
    return lfilter([np.sqrt(1 - memory**2)], [1, -memory], noise)[5000:]


def mean_square(x):
    return comparison.mean_square(x * x, len(x))


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99, 0.998])
def test_the_true_mean_square_is_in_the_interval(memory):
    """Nine times in ten or more, of the 95 % that are meant; counted as independent it would be two times in ten."""
    found = [mean_square(correlated(20_000, memory, seed)) for seed in range(200)]
    inside = [abs(one.value - 1.0) < 2.1 * one.standard_error for one in found]
    assert np.mean(inside) > 0.88
    naive = [np.std(correlated(20_000, memory, seed) ** 2) / np.sqrt(20_000) for seed in range(20)]
    if memory > 0.9:
        assert np.mean([one.standard_error for one in found]) > 3 * np.mean(naive)


def test_a_difference_is_found_and_its_size():
    found = [
        ratio(mean_square(correlated(20_000, 0.9, k)), mean_square(0.8 * correlated(20_000, 0.9, 1000 + k)))
        for k in range(50)
    ]
    assert {one.verdict for one in found} == {"lower"}
    assert np.mean([one.value for one in found]) == pytest.approx(0.8, rel=0.01)
    assert np.mean([one.low < 0.8 < one.high for one in found]) > 0.85
    back = ratio(mean_square(0.8 * correlated(20_000, 0.9, 1)), mean_square(correlated(20_000, 0.9, 2)))
    assert back.verdict == "higher"


CONFIGURATION = "loop: {rate_hz: 10000}\naxes: {x: {inner: {K: 0.6}}, y: {}}\n"


def recording(file, amplitude=1.0, tracking=slice(None), fault=0, marks=()):
    """A sine of 66 Hz, and noise, as the path error of axis x; 60 V with 5 V of swing."""
    rows = some_rows(42, 20_000)
    t = np.arange(len(rows)) * 1e-4
    rows["state"][tracking] = TRACKING
    rows["lateness_ns"], rows["lateness_ns"][100] = 100, 9000
    rows["fault"][-5:] = fault
    rows["axis"]["path_error_um"] = 0.01 * rows["axis"]["innovation_um"]
    rows["axis"]["path_error_um"][:, 0] += amplitude * np.sqrt(2) * np.sin(2 * np.pi * 66 * t)
    rows["axis"]["voltage_V"] = 60 + 5 * np.sin(2 * np.pi * 2 * t)[:, None]
    sets = slots(1)
    sets["axis"]["limiter"]["low_V"], sets["axis"]["limiter"]["high_V"] = -20, 100
    written = begun(file)
    for part in np.array_split(rows, 40):
        written.append(part, sets)
    for mark in marks:
        written.mark(mark, 5000, "alice", 5000 * 100_000)
    written.close()
    return file


def test_a_known_sine(tmp_path):
    file = recording(tmp_path / "run.mcap", tracking=slice(10_000, None), fault=3)
    found = run_figures(RecordedRun(open_telemetry(file)))
    x = found.axes["x"]
    assert x.rms_um == pytest.approx(1.0, rel=1e-3)
    assert x.peak_Hz == pytest.approx(66.0, rel=0.01)
    assert x.peak_um == pytest.approx(1.0, rel=0.01)
    assert x.bands_um[1] == pytest.approx(1.0, rel=0.01)
    assert np.sqrt(np.sum(np.square(found.axes["y"].bands_um))) == pytest.approx(0.01, rel=0.05)
    assert x.headroom_V == pytest.approx(35.0, rel=1e-3)
    assert found.tracking_s == pytest.approx(1.0)
    assert found.lateness_ns == (100, 100, 9000)
    assert (found.skipped, found.lost, found.faults) == (0, 0, (KINDS[3].code,))


def test_configurations_key_by_key():
    other = CONFIGURATION.replace("0.6", "0.5").replace("y: {}", "y: {}, z: {inner: {K: 1}}")
    assert configuration_changes(CONFIGURATION, other) == [
        {"key": "axes.x.inner.K", "old": 0.6, "new": 0.5},
        {"key": "axes.z.inner.K", "old": None, "new": 1},
    ]
    assert configuration_changes(CONFIGURATION, CONFIGURATION) == []


def test_the_command(tmp_path, capsys):
    a, b = recording(tmp_path / "a.mcap"), recording(tmp_path / "b.mcap", amplitude=0.5)
    assert code_of("recording", "compare", a, b, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["axes"]["x"]["verdict"] == "lower"
    assert told["axes"]["x"]["ratio"] == pytest.approx(0.5, rel=1e-3)
    assert told["axes"]["y"]["verdict"] == "no difference shown"
    greatest = next(each for each in told["quantities"] if each["quantity"] == "error, greatest")
    assert (greatest["low"], greatest["verdict"]) == (None, "not judged")
    assert told["configuration"] == []
    assert code_of("recording", "compare", a, b) == 0
    shown = capsys.readouterr().out
    assert "lower" in shown
    assert "the configurations are the same" in shown


@pytest.mark.long
def test_a_report(tmp_path, capsys):
    """One file: small, without anything from elsewhere, with what the figures say and what people wrote."""
    file = recording(tmp_path / "run.mcap", marks=("<script>alert(1)</script>",))
    assert code_of("recording", "report", file, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["run"]["axes"]["x"]["peak_Hz"] == pytest.approx(66.0, rel=0.01)
    text = (tmp_path / "run.html").read_text()
    assert told["page"] == str(tmp_path / "run.html")
    assert len(text) < 1_000_000
    page = Page(tmp_path / "run.html")
    assert not [tag for tag, _ in page.elements if tag in ("img", "link", "iframe")]
    scripts = [given.get("data-plot", "the page's own") for tag, given in page.elements if tag == "script"]
    assert scripts == [*(f"plot-{number}" for number in range(1, len(scripts))), "the page's own"]
    assert len(scripts) > 5
    links = [value for _, given in page.elements for name, value in given.items() if name.endswith(("href", "src"))]
    assert all(link.startswith("#") for link in links)
    assert "<script>alert(1)</script>" in page.text
    assert "1.0000" in page.words
    assert CONFIGURATION_IN_FILE in page.text
    assert code_of("recording", "report", file) == 64
    assert "nothing is replaced" in capsys.readouterr().err


def in_parts(values, lengths, axis=-1):
    """`values` cut into parts of these lengths, over and over."""
    edges = np.cumsum(np.resize(lengths, 1 + values.shape[axis]))
    return np.split(values, edges[edges < values.shape[axis]], axis=axis)


@given(st.lists(st.integers(1, 700), min_size=1, max_size=5), st.integers(1, 3000))
def test_what_is_read_in_parts_is_what_it_would_be_at_once(lengths, count):
    values = np.random.default_rng(count).normal(size=count)
    counts, sections = Counts(), Sections(30, lambda part: part.max(axis=1))
    for part in in_parts(values, lengths):
        counts.add(np.round(1e6 * part).astype(np.int64))
        sections.add(part)
    expected = np.percentile(np.round(1e6 * values), (0.0, 50.0, 99.9, 100.0))
    np.testing.assert_allclose(counts.percentiles((0.0, 50.0, 99.9, 100.0)), expected, atol=1e-6)
    np.testing.assert_array_equal(sections.found, values[: count // 30 * 30].reshape(-1, 30).max(axis=1))


@given(st.lists(st.integers(1, 900), min_size=1, max_size=5), st.integers(2, 2500))
def test_the_spectrum_in_parts_is_welchs(lengths, count):
    values = np.random.default_rng(count).normal(size=count)
    found = Spectra(400.0, [(0.0, 50.0), (50.0, 201.0)])
    for part in in_parts(values, lengths):
        found.add(part)
    found.end()
    segment = min(400, count)
    frequency, density = welch(values, 400.0, "hann", segment, segment // 2, detrend="constant")
    np.testing.assert_allclose(found.density, density, rtol=1e-9)
    assert found.power.sum(axis=1).mean() == pytest.approx(density.sum() * frequency[1], rel=1e-9)


def test_the_first_piece_may_be_the_damaged_one(tmp_path):
    """Though what describes the rows stands in it, too."""
    file = recording(tmp_path / "run.mcap")
    whole = open_telemetry(file)
    damage(file, 0.0)
    telemetry = open_telemetry(file)
    assert (telemetry.dtype, telemetry.axes, telemetry.sha256) == (whole.dtype, whole.axes, whole.sha256)
    run = RecordedRun(telemetry)
    (gap,) = run.unread
    assert gap.cycles <= 1000
    assert run.axis["x"].samples == 20_000 - gap.cycles
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])  # cut off, there is nowhere else to read it
    with pytest.raises(CheckFailed, match="damaged"):
        open_telemetry(file)


def test_a_damaged_piece_is_told_and_the_rest_is_read(tmp_path, capsys):
    file = recording(tmp_path / "run.mcap")
    whole = run_figures(RecordedRun(open_telemetry(file)))
    damage(file, 0.5)
    run = RecordedRun(open_telemetry(file))
    (gap,) = run.unread
    assert 5_000 < gap.first < 15_000
    assert 0 < gap.cycles <= 1000
    assert run.axis["x"].samples == 20_000 - gap.cycles
    found = run_figures(run)
    assert (found.lost, whole.unread) == (0, ())
    assert found.axes["x"].rms_um == pytest.approx(whole.axes["x"].rms_um, rel=1e-2)
    assert code_of("recording", "report", file, "--json") == 0
    printed = capsys.readouterr()
    begin_s, end_s = run.at_s(gap.first), run.at_s(gap.last)
    assert end_s - begin_s == pytest.approx((gap.cycles - 1) * 1e-4)
    seconds = f"from {begin_s:.3f} s to {end_s + 1e-4:.3f} s"
    assert f"warning: {file}: The file is damaged {seconds}: that is missing" in printed.err
    assert json.loads(printed.out)["run"]["unread"] == [[begin_s, end_s]]
    assert f"The file is damaged {seconds}" in (tmp_path / "run.html").read_text()
