"""The report: what it says, that nothing in it is taken for HTML, and that it needs nothing but itself."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest

from micromanip.design.commission.report import write_report
from micromanip.design.report.model import Criterion, Curve, Evidence, Plot, Section, Table

NASTY = """<script>alert("x")</script> & <b title='y'>"""
T = np.linspace(0.0, 1.0, 50)
MET = Criterion("x", "gain margin", True, "8.1 dB", ">= 6 dB")
MISSED = Criterion("x", "phase margin", False, "21 deg", ">= 35 deg")


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
