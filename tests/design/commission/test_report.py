"""The report: what it says, that nothing in it is taken for HTML, and that it needs nothing but itself."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from micromanip.design.commission.evidence import Curve, Evidence, Plot, Section, Table
from micromanip.design.commission.report import write_report
from micromanip.design.criterion import Criterion

NASTY = """<script>alert("x")</script> & <b title='y'>"""
T = np.linspace(0.0, 1.0, 50)
PLOT = Plot("Step response", "Time (s)", "Position (um)", (Curve("measured", T, T**2), Curve("model", T, T)))
MET = Criterion("x", "gain margin", True, "8.1 dB", ">= 6 dB")
MISSED = Criterion("x", "phase margin", False, "21 deg", ">= 35 deg")
SECTION = Section("Linear dynamics", "First.\n\nSecond.", {"Order": "4"}, (PLOT,))


class Page(HTMLParser):
    """What a reader of the page's markup sees: elements with attributes, text, scripts."""

    VOID = frozenset({"meta", "line", "circle", "br"})

    def __init__(self, file):
        super().__init__()
        self.elements, self.text, self.scripts, self.open = [], "", [], []
        self.feed(file.read_text(encoding="utf-8"))
        assert self.open == [], "an element is not closed"

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.text += " "
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append((dict(attrs), ""))

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            attributes, text = self.scripts.pop()
            self.scripts.append((attributes, text + data))
        elif not (self.open and self.open[-1] == "style"):
            self.text += data

    @property
    def words(self):
        return " ".join(self.text.split())

    @property
    def figures(self):
        """The plots' data."""
        return [json.loads(text) for attributes, text in self.scripts if "data-plot" in attributes]


@pytest.fixture
def written(tmp_path):
    def write(*axes, title="Commissioning", facts=None, hashes=None):
        file = tmp_path / "report.html"
        write_report(file, title, facts or {}, axes, hashes or {})
        return Page(file)

    return write


def seen(figure, curve):
    """Points of a curve as the page's script decodes them: two columns, gaps as nan."""
    words = np.frombuffer(base64.b64decode(curve["points"]), "<u2").reshape(2, -1).astype(float)
    low, high = np.array(figure["span"]).T
    places = low[:, None] + words / 65534 * (high - low)[:, None]
    places[:, words[0] == 65535] = np.nan
    return places


def test_the_verdict_stands_on_top_in_words(written):
    page = written(Evidence("x", (MET, MISSED), (SECTION,)), Evidence("y", (MET,), ()), hashes={"x": "0123abcd"})
    top, rest = page.words.split("Summary", 1)
    assert "FAIL 2 of 3 criteria are met; not met: axis x: phase margin." in top
    assert re.search(r"Axis x ✗ FAIL 1 of 2 0123abcd", rest)
    assert re.search(r"Axis y ✓ PASS 1 of 1 none", rest)
    assert "phase margin ✗ FAIL 21 deg >= 35 deg" in rest
    assert "gain margin ✓ PASS 8.1 dB >= 6 dB" in rest
    assert rest.index("phase margin ✗") < rest.index("gain margin ✓"), "what fails comes first"


def test_pass_only_where_every_axis_was_judged(written):
    judged, unjudged = Evidence("x", (MET,), ()), Evidence("y", (), ())
    assert "PASS 1 of 1 criteria are met." in written(judged).words
    assert "NOT JUDGED 1 of 1 criteria are met; without any criterion: axis y." in written(judged, unjudged).words
    assert "FAIL" in written(Evidence("x", (MISSED,), ()), unjudged).words.split("Summary")[0]
    assert "NOT JUDGED" in written().words


def test_every_text_is_escaped(written):
    curve = Curve(NASTY, T, T)
    plot = Plot(NASTY, NASTY, NASTY, (curve,), note=NASTY)
    criterion = Criterion(NASTY, NASTY, False, NASTY, NASTY)
    table = Table(NASTY, (NASTY, NASTY), ((NASTY, NASTY),))
    axis = Evidence(NASTY, (criterion,), (Section(NASTY, NASTY, {NASTY: NASTY}, (plot,), (table,)),))
    page = written(axis, title=NASTY, facts={NASTY: NASTY}, hashes={NASTY: NASTY})
    assert [attributes for tag, attributes in page.elements if tag == "b"] == []
    assert [tuple(attributes) for attributes, _ in page.scripts] == [("type", "data-plot"), ()]
    assert page.words.count(NASTY) >= 22
    (label,) = [attributes["aria-label"] for _, attributes in page.elements if "aria-label" in attributes]
    assert NASTY in label
    assert page.figures[0]["curves"][0]["name"] == NASTY, "the script sets it as text"


def test_it_needs_nothing_from_elsewhere(written, tmp_path):
    page = written(Evidence("x", (MET,), (SECTION,)))
    links = [v for _, attributes in page.elements for k, v in attributes.items() if k in ("src", "href", "srcset")]
    assert links
    assert all(link.startswith("#") for link in links)
    ids = {attributes["id"] for _, attributes in page.elements if "id" in attributes}
    assert {link[1:] for link in links} <= ids
    style = (tmp_path / "report.html").read_text(encoding="utf-8").split("<style>")[1].split("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style
    (policy,) = [a["content"] for _, a in page.elements if a.get("http-equiv") == "Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy


def test_plots_hold_the_curves(written):
    nyquist = replace(PLOT, equal=True, curves=(Curve("points", T, -T, marks=True, texts=("a",) * 50),))
    bode = replace(PLOT, log_x=True, log_y=True)
    page = written(Evidence("x", (MET,), (replace(SECTION, plots=(PLOT, nyquist, bode)),)))
    plain, equal, log = page.figures
    assert [curve["name"] for curve in plain["curves"]] == ["measured", "model"]
    x, y = seen(plain, plain["curves"][0])
    np.testing.assert_allclose(x, T, atol=1e-4)
    np.testing.assert_allclose(y, T**2, atol=1e-4)
    assert "marks" not in plain["curves"][0]
    assert equal["curves"][0]["marks"]
    assert equal["curves"][0]["texts"] == ["a"] * 50
    assert [figure["equal"] for figure in (plain, equal, log)] == [False, True, False]
    assert (plain["log"], log["log"]) == ([False, False], [True, True])
    x, y = seen(log, log["curves"][0])
    assert np.isnan(x[0]), "0 has no logarithm"
    np.testing.assert_allclose(x[1:], np.log10(T[1:]), atol=1e-4)
    places = [attributes["data-plot"] for attributes, _ in page.scripts if "data-plot" in attributes]
    assert len({*places}) == 3


def test_the_same_evidence_gives_the_same_bytes(tmp_path):
    axes = [Evidence("x", (MET, MISSED), (SECTION,))]
    for name in ("one", "two"):
        write_report(tmp_path / name, "Commissioning", {"Date": "today"}, axes, {"x": "0123"})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
