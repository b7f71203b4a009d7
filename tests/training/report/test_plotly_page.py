"""The page of a part: all that was found is on it, in one file that runs nothing but its own."""

import json
import re
from html.parser import HTMLParser

import plotly.graph_objects as go
import pytest

from tests.training.study.fake_chapters import fake_chapter, fake_result, verdict
from training.report.plotly_page import PageHead, page_of
from training.report.plotly_picture import plotly_of
from training.study.finding import Computed, Finding, Timing
from training.study.headlines import summary
from training.study.picture import Axis, Line, Lines
from vehicle_client.simulator.plan import SensorGrade

GRADES = tuple(SensorGrade)
VOID = {"meta", "br", "img", "link"}


class Outline(HTMLParser):
    """What a browser would see: tags that open and close in order, and the ids they carry."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.addresses: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value)
            if name == "href":
                self.links.append(value)
            if name in {"src", "href"} and not value.startswith("#"):
                self.addresses.append(value)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in {"script", "style"}:
            self.words.append(data)


def finding_of(name: str) -> Finding:
    computed = {
        grade: Computed(fake_result(mape=mape), Timing(60.0, 90.0), "abc", {})
        for grade, mape in zip(GRADES, (0.02, 0.04), strict=True)
    }
    results = {grade: done.result for grade, done in computed.items()}
    return Finding(fake_chapter(name), computed, verdict(results))


@pytest.fixture(scope="module")
def page() -> str:
    failed = Finding(fake_chapter("broken & gone"), {}, None, {"ideal": "ValueError: <no>"})
    findings = (finding_of("one"), failed)
    return page_of(
        PageHead("A <study>", "Why.", "made so"), findings, summary(findings, seed=1, quick=True, version="1")
    )


@pytest.fixture(scope="module")
def outline(page) -> Outline:
    return Outline(page)


def test_the_page_is_well_formed_and_needs_nothing_else(outline):
    assert outline.open == []
    assert outline.addresses == []


def test_the_contents_lead_to_every_chapter(outline):
    assert outline.links == ["#one", "#broken-gone"]
    assert set(outline.ids) >= {"one", "broken-gone"}


def test_a_person_reads_claim_verdict_tables_and_sizes(outline):
    text = " ".join(outline.words)
    for words in (
        "Does one work?",
        "It does, with 3 %.",
        "partly confirmed",
        "It came to 2.0 %",
        "Ideal sensors",
        "Automotive sensors",
        "Error | by road",
        "<long>",
        "10,000",
        "rows count: 60",
        "ValueError: <no>",
        "A <study>",
        "unseen roads, MAPE, full coverage",
    ):
        assert words in text


def test_the_library_of_figures_is_there_once(page):
    assert page.count("plotly.js v") == 1


def test_every_figure_has_its_place_and_plotly_takes_it(page):
    embedded = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)
    assert embedded is not None
    figures = json.loads(embedded[1])
    assert len(figures) == 5  # of four kinds, one of which differs between the sensors
    assert re.findall(r'data-figure="(.*?)"', page) == list(figures)
    for figure in figures.values():
        go.Figure(figure)


def test_an_end_of_a_logarithmic_axis_is_given_as_plotly_wants_it():
    picture = Lines(
        "l", Axis("x", low=10.0, logarithmic=True), Axis("y", low=0.0, high=1.0), (Line("a", (1.0,), (2.0,)),)
    )
    layout = plotly_of(picture)["layout"]
    assert layout["xaxis"]["range"] == [1.0, None]
    assert layout["yaxis"]["range"] == [0.0, 1.0]
