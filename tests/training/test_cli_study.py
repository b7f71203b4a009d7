"""The commands of the study: what they write, what they say, how they end."""

import json

import pytest
from typer.testing import CliRunner

from tests.training.study.fake_chapters import fake_chapter, fake_result
from training.cli import app
from training.study.chapter import Result
from training.study.registry import Part
from vehicle_client.simulator.plan import SensorGrade

QUIET = ("--no-tracking",)


class Chapters:
    """The chapters that the commands find, and how often they were computed."""

    def __init__(self) -> None:
        self.computed: list[str] = []
        self.fail = False
        self.of = {Part.PAPER: (self.chapter("one"), self.chapter("two")), Part.GENERALISE: (self.chapter("three"),)}

    def chapter(self, name: str):
        def compute(bench, grade: SensorGrade) -> Result:
            if self.fail:
                raise ValueError("no such luck [/red]")
            bench.report("folding", 1, 2)
            self.computed.append(f"{name} {grade.value} {'quick' if bench.quick else 'full'}")
            return fake_result()

        return fake_chapter(name, compute=compute, needs=())


@pytest.fixture
def chapters(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fakes = Chapters()
    monkeypatch.setattr("training.cli_study.chapters_of", lambda part: fakes.of[part])
    return fakes


def invoke(*arguments: str):
    return CliRunner().invoke(app, ["study", *arguments])


def test_a_study_writes_page_and_small_files_and_says_where(chapters, tmp_path):
    result = invoke("paper", *QUIET)
    assert result.exit_code == 0, result.output
    assert len(chapters.computed) == 4
    assert "Does one work?" in (tmp_path / "build/study/report-paper.html").read_text(encoding="utf-8")
    out = tmp_path / "docs/results/study"
    assert {path.name for path in out.iterdir()} == {"README.md", "summary.json", "one", "two"}
    assert "partly confirmed" in result.output
    assert "report-paper.html" in result.output


def test_a_second_study_computes_nothing_and_writes_the_same(chapters, tmp_path):
    invoke("paper", *QUIET)
    before = {path: path.read_bytes() for path in (tmp_path / "docs").rglob("*.*")}
    result = invoke("paper", *QUIET)
    assert len(chapters.computed) == 4
    assert "cached" in result.output
    assert {path: path.read_bytes() for path in (tmp_path / "docs").rglob("*.*")} == before


def test_headlines_keep_what_the_other_part_found(chapters, tmp_path):
    invoke("paper", *QUIET)
    invoke("generalise", *QUIET)
    summary = json.loads((tmp_path / "docs/results/study/summary.json").read_text(encoding="utf-8"))
    assert set(summary["chapters"]) == {"one", "two", "three"}
    assert summary["seed"] == 1
    assert summary["quick"] is False


def test_a_quick_study_touches_nothing_of_the_full_one(chapters, tmp_path):
    result = invoke("paper", "--quick", "--only", "one", "--sensors", "ideal", *QUIET)
    assert result.exit_code == 0, result.output
    assert chapters.computed == ["one ideal quick"]
    assert not (tmp_path / "docs").exists()
    assert (tmp_path / "build/study-quick/results/one/chapter.json").is_file()


def test_a_chapter_that_fails_is_named_and_the_command_says_so(chapters, tmp_path):
    invoke("paper", "--only", "two", *QUIET)
    chapters.fail = True
    result = invoke("paper", *QUIET)
    assert result.exit_code == 1
    assert "no such luck [/red]" in result.output
    assert "no such luck" in (tmp_path / "build/study/failures/one-ideal-sensors.txt").read_text(encoding="utf-8")
    summary = json.loads((tmp_path / "docs/results/study/summary.json").read_text(encoding="utf-8"))
    assert "one, ideal: ValueError: no such luck [/red]" in summary["defects"]


def test_a_plan_alone_does_nothing(chapters, tmp_path):
    result = invoke("paper", "--plan")
    assert result.exit_code == 0, result.output
    assert "to do" in result.output
    assert chapters.computed == []


def test_an_unknown_chapter_is_refused_with_the_known_ones(chapters):
    result = invoke("paper", "--only", "three", *QUIET)
    assert result.exit_code == 2
    assert "one, two" in " ".join(result.output.split())


def test_the_list_names_chapters_for_people_and_machines(chapters):
    assert "Does three work?" in invoke("list").output
    listed = json.loads(invoke("list", "--json").stdout)
    assert [chapter["name"] for chapter in listed["paper"]] == ["one", "two"]
