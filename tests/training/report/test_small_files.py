"""What a repository keeps of the study: readable there, complete for machines, nothing left over."""

import csv
import json

import pytest

from tests.training.study.fake_chapters import fake_chapter, fake_result, verdict
from training.report.small_files import index_page, markdown_of, write_chapter, write_summary
from training.report.wording import cell_text, number_text, pairs_of, percent_text, slug
from training.study.chapter import Result, Table
from training.study.finding import Computed, Finding, Timing
from training.study.headlines import summary
from training.study.registry import Part
from vehicle_client.simulator.plan import SensorGrade


def finding_of(name: str, result: Result) -> Finding:
    computed = {grade: Computed(result, Timing(60.0, 90.0), "abc", {}) for grade in SensorGrade}
    return Finding(fake_chapter(name), computed, verdict({SensorGrade.IDEAL: result}))


def test_a_chapter_becomes_files_that_its_page_names(tmp_path):
    written = write_chapter(finding_of("one", fake_result()), tmp_path)
    assert {path.suffix for path in written} == {".json", ".csv", ".svg", ".md"}
    assert all(path.is_file() and path.parent == tmp_path / "one" for path in written)
    page = (tmp_path / "one/README.md").read_text(encoding="utf-8")
    # What is the same with all sensors is shown once.
    shown = [path.name for path in written if path.suffix != ".md" and not path.name.startswith("automotive-picture")]
    assert all(name in page for name in shown)
    assert "**\u25d0 partly confirmed**" in page
    assert "| s-turn | 2.00 | 12 |" in page


def test_tables_are_csv_with_all_their_digits(tmp_path):
    write_chapter(finding_of("one", fake_result(mape=0.0123456)), tmp_path)
    with (tmp_path / "one/ideal-table-1-error-by-road.csv").open(encoding="utf-8") as file:
        assert list(csv.reader(file)) == [
            ["road", "MAPE, %", "runs"],
            ["s-turn", "1.23456", "12"],
            ["<long>", "", "10000"],
        ]


def test_the_document_of_a_chapter_says_what_it_took_and_what_was_made_of_it(tmp_path):
    write_chapter(finding_of("one", fake_result()), tmp_path)
    document = json.loads((tmp_path / "one/chapter.json").read_text(encoding="utf-8"))
    assert document["claim"] == "partly confirmed"
    assert document["results"]["ideal"]["figures"]["mape"] == 0.02
    assert document["results"]["ideal"]["figures"]["undefined"] is None
    assert document["results"]["automotive"]["wall_s"] == 60.0


def test_files_of_before_go_and_those_of_others_stay(tmp_path):
    write_chapter(finding_of("one", fake_result()), tmp_path)
    (tmp_path / "one/notes.txt").write_text("mine", encoding="utf-8")
    write_chapter(finding_of("one", Result({"mape": 0.1}, {})), tmp_path)
    assert {path.name for path in (tmp_path / "one").iterdir()} == {"README.md", "chapter.json", "notes.txt"}


def test_the_same_findings_are_the_same_files(tmp_path):
    first = {path.name: path.read_bytes() for path in write_chapter(finding_of("one", fake_result()), tmp_path)}
    again = {path.name: path.read_bytes() for path in write_chapter(finding_of("one", fake_result()), tmp_path)}
    assert first == again


def test_what_differs_between_sensors_is_shown_for_each_and_what_does_not_once(tmp_path):
    computed = {
        grade: Computed(
            Result({}, {}, (Table("same", ("a",), ((1,),)), Table("own", ("a",), ((i,),)), Table("own", ("b",), ()))),
            Timing(1.0, 1.0),
            "",
            {},
        )
        for i, grade in enumerate(SensorGrade)
    }
    write_chapter(Finding(fake_chapter("one"), computed, None), tmp_path)
    page = (tmp_path / "one/README.md").read_text(encoding="utf-8")
    assert page.count("## same") == 1
    assert page.count("**Both grades of sensors**") == 2
    assert page.count("## own") == 2
    assert page.count("**Automotive sensors**") == 1


def test_the_index_leads_to_chapters_and_shows_targets(tmp_path):
    findings = {Part.PAPER: (finding_of("one", fake_result()),), Part.GENERALISE: ()}
    document = summary(findings[Part.PAPER], seed=1, quick=False, version="1")
    machine, person = write_summary(findings, document, tmp_path)
    assert json.loads(machine.read_text(encoding="utf-8")) == document
    page = person.read_text(encoding="utf-8")
    assert page == index_page(findings, document)
    assert "[Does one work?](one/README.md)" in page
    assert "**2.00 %** | \u2264 2.50 %" in page
    assert "It came to 2.0 %. |" in page


def test_a_table_cannot_be_broken_by_what_stands_in_it():
    lines = markdown_of(Table("t", ("a|b",), (("c|d\ne",),))).splitlines()
    assert lines == ["| a\\|b |", "|---|", "| c\\|d e |"]


@pytest.mark.parametrize(
    "title",
    ["Boxes, ideal sensors", "Boxes (ideal)", "Boxes with ideal sensors", "Boxes: ideal", "Ideal sensors: boxes"],
)
def test_titles_that_name_their_sensors_are_a_pair(title):
    other = title.replace("ideal", "automotive").replace("Ideal", "Automotive")
    shown = {
        SensorGrade.IDEAL: (Table(title, ("a",), ((1,),)),),
        SensorGrade.AUTOMOTIVE: (Table(other, ("a",), ((2,),)),),
    }
    (pair,) = pairs_of(shown)
    assert [grade for grade, _ in pair] == ["Ideal sensors", "Automotive sensors"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1234.4, "1234"),
        (12.345, "12.3"),
        (0.012345, "0.0123"),
        (-0.5, "-0.500"),
        (1e-9, "1.00e-09"),
        (float("nan"), "\u2013"),
    ],
)
def test_numbers_have_three_digits(value, text):
    assert number_text(value) == text


def test_words_for_cells():
    assert [cell_text(cell) for cell in (None, "x", 9999, 44_000)] == ["\u2013", "x", "9999", "44,000"]
    assert percent_text(0.0251) == "2.51 %"
    assert percent_text(None) == "\u2013"
    assert slug("Error | by <road>, %") == "error-by-road"
