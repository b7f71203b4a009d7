"""A study goes on whatever one chapter does, and says what is done, what is to do and what went wrong."""

from dataclasses import dataclass, field

import pytest

from tests.training.study.fake_chapters import MadeUpSource, fake_chapter, fake_result
from training.study.chapter import Result
from training.study.course import State, conduct, kept_findings, plan
from training.study.finding import LONGEST_STAGE_S, Computed, Finding, Timing
from training.study.workbench import StudyWorkbench
from vehicle_client.simulator.plan import SensorGrade

GRADES = tuple(SensorGrade)
IDEAL = SensorGrade.IDEAL


@dataclass
class Diary:
    told: list[str] = field(default_factory=list)

    def begins(self, what):
        self.told.append(f"begins {what}")

    def ends(self, what, computed, *, kept):
        self.told.append(f"{'keeps' if kept else 'ends'} {what}")

    def fails(self, what, details):
        self.told.append(f"fails {what}: {details.strip().splitlines()[-1]}")

    def found(self, finding):
        self.told.append(f"found {finding.chapter.name}")


@pytest.fixture
def source():
    return MadeUpSource()


@pytest.fixture
def bench(tmp_path, source):
    return StudyWorkbench(tmp_path, source=source, code_of=lambda _: "as ever")


def broken(bench: object, grade: SensorGrade) -> Result:
    raise ValueError("no such luck")


def test_the_plan_names_data_and_chapters_and_what_is_there(bench):
    chapters = (fake_chapter("a"), fake_chapter("b"))
    states = {(stage.name, stage.grade.value): stage.state for stage in plan(bench, chapters, (IDEAL,))}
    assert states == {(name, "ideal"): State.MISSING for name in ("paper", "a", "b")}
    conduct(bench, chapters[:1], (IDEAL,), Diary())
    later = {stage.name: stage.state for stage in plan(bench, chapters, (IDEAL,))}
    assert later == {"paper": State.DONE, "a": State.DONE, "b": State.MISSING}


def test_a_study_that_is_done_needs_no_data(bench, source):
    conduct(bench, (fake_chapter("a"),), GRADES, Diary())
    source.made.clear()
    again = StudyWorkbench(bench.folder, source=source, code_of=lambda _: "as ever")
    assert [stage.name for stage in plan(again, (fake_chapter("a"),), GRADES)] == ["a", "a"]
    conduct(again, (fake_chapter("a"),), GRADES, Diary())
    assert source.made == []


def test_what_is_kept_is_told_from_what_is_computed(bench):
    diary = Diary()
    for _ in range(2):
        conduct(bench, (fake_chapter("a"),), (IDEAL,), diary)
    once = ["begins a, ideal sensors", "ends a, ideal sensors", "found a"]
    assert diary.told == [*once, "begins a, ideal sensors", "keeps a, ideal sensors", "found a"]


def test_a_chapter_that_fails_takes_nothing_from_the_others(bench):
    diary = Diary()
    bad, good = conduct(bench, (fake_chapter("bad", compute=broken), fake_chapter("good")), (IDEAL,), diary)
    assert bad.failures == {"ideal": "ValueError: no such luck"}
    assert bad.verdict is None
    assert bad.defects == ("bad, ideal: ValueError: no such luck",)
    assert good.verdict is not None
    assert "fails bad, ideal sensors: ValueError: no such luck" in diary.told
    assert diary.told[-1] == "found good"


def test_a_verdict_that_fails_leaves_the_figures(bench):
    def undecided(results):
        return results[SensorGrade.AUTOMOTIVE]

    (finding,) = conduct(bench, (fake_chapter("a", judge=undecided),), (IDEAL,), Diary())
    assert finding.verdict is None
    assert finding.failures["verdict"].startswith("KeyError")
    assert set(finding.results) == {IDEAL}


def test_one_grade_alone_is_judged_with_what_the_other_found_before(bench):
    conduct(bench, (fake_chapter("a"),), GRADES, Diary())
    (finding,) = conduct(bench, (fake_chapter("a"),), (IDEAL,), Diary())
    assert tuple(finding.results) == GRADES


def test_what_was_found_before_is_found_without_computing(bench, source):
    chapters = (fake_chapter("a"), fake_chapter("b"))
    conduct(bench, chapters[:1], GRADES, Diary())
    (finding,) = kept_findings(bench, chapters)
    assert finding.chapter.name == "a"
    assert finding.defects == ()
    source.digests["paper"] = "driven anew"
    (old,) = kept_findings(bench, chapters)
    assert old.defects == tuple(
        f"a, {grade.value} sensors: code or data have changed since it was computed" for grade in GRADES
    )


def test_a_stage_that_takes_too_long_is_a_defect():
    took = Timing(wall_s=LONGEST_STAGE_S + 60.0, cpu_s=1.0)
    finding = Finding(fake_chapter("a"), {IDEAL: Computed(fake_result(), took, "", {})}, None)
    assert finding.defects == ("a, ideal sensors: took 46 minutes, more than a stage may",)
