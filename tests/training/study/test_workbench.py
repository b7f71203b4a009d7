"""What is kept is taken as long as code and data stand, and no longer."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from tests.training.study.fake_chapters import MadeUpSource, fake_chapter, fake_result
from training.report.wording import cell_text, number_text
from training.study.chapter import Arrays, Result, Workbench
from training.study.workbench import StudyWorkbench, reached_code_digest
from vehicle_client.simulator.plan import SensorGrade

IDEAL, AUTOMOTIVE = SensorGrade.IDEAL, SensorGrade.AUTOMOTIVE


class Bench:
    """Makes workbenches in one folder, as one study after another would."""

    def __init__(self, folder):
        self.folder = folder
        self.source = MadeUpSource()
        self.code = "as ever"
        self.calls: list[str] = []

    def __call__(self, **options) -> StudyWorkbench:
        code = self.code
        return StudyWorkbench(self.folder, source=self.source, code_of=lambda _: code, **options)

    def work(self, bench: StudyWorkbench | None = None, *, reads: str | None = None) -> Callable[[], Arrays]:
        def compute() -> Arrays:
            self.calls.append("arrays")
            if bench is not None and reads is not None:
                bench.runs(reads, IDEAL)
            return {"mu": np.arange(3.0)}

        return compute

    def counted(self, bench: Workbench, grade: SensorGrade) -> Result:
        self.calls.append(f"result {grade.value}")
        bench.runs("paper", grade)
        return fake_result()


@pytest.fixture
def study(tmp_path):
    return Bench(tmp_path)


def test_arrays_are_computed_once_and_come_back_as_they_were(study):
    first = study().remembered("x", study.work())
    again = study().remembered("x", study.work())
    assert study.calls == ["arrays"]
    np.testing.assert_array_equal(again["mu"], first["mu"])
    assert list(again) == ["mu"]


def test_arrays_of_another_name_seed_or_quickness_are_others(study):
    study().remembered("x", study.work())
    study().remembered("y", study.work())
    study(seed=2).remembered("x", study.work())
    study(quick=True).remembered("x", study.work())
    assert len(study.calls) == 4


def test_an_edit_of_the_code_computes_again(study):
    study().remembered("x", study.work())
    study.code = "edited"
    study().remembered("x", study.work())
    assert len(study.calls) == 2


@pytest.mark.parametrize(("changed", "calls_count"), [("paper", 2), ("manoeuvres", 1)])
def test_arrays_follow_the_data_sets_they_were_computed_from(study, changed, calls_count):
    for _ in range(2):
        bench = study()
        bench.remembered("x", study.work(bench, reads="paper"))
        study.source.digests[changed] = "driven anew"
    assert len(study.calls) == calls_count


def test_a_file_that_was_cut_short_is_computed_again(study):
    study().remembered("x", study.work())
    (path,) = (study.folder / "cache/arrays").iterdir()
    path.write_bytes(path.read_bytes()[:100])
    study().remembered("x", study.work())
    assert len(study.calls) == 2


def test_results_are_computed_once_for_each_grade(study):
    chapter = fake_chapter("a", compute=study.counted)
    first = study().computed(chapter, IDEAL)
    again = study().computed(chapter, IDEAL)
    study().computed(chapter, AUTOMOTIVE)
    assert study.calls == ["result ideal", "result automotive"]
    assert repr(again.result) == repr(first.result)
    assert again.timing == first.timing
    assert again.data == {"paper ideal": "paper ideal as ever"}


def test_results_follow_arrays_that_others_computed_before(study):
    def compute(bench: Workbench, grade: SensorGrade) -> Result:
        study.calls.append("result")
        bench.remembered("x", study.work(bench, reads="random-roads"))
        return fake_result()

    bench = study()
    bench.remembered("x", study.work(bench, reads="random-roads"))
    assert study().computed(fake_chapter("a", compute=compute), IDEAL).data == {
        "random-roads ideal": "random-roads ideal as ever"
    }
    study.source.digests["random-roads"] = "driven anew"
    assert study().kept(fake_chapter("a", compute=compute), IDEAL).stale


def test_what_is_kept_but_not_current_says_so(study):
    chapter = fake_chapter("a", compute=study.counted)
    assert study().kept(chapter, IDEAL) is None
    study().computed(chapter, IDEAL)
    assert not study().kept(chapter, IDEAL).stale
    study.code = "edited"
    assert study().kept(chapter, IDEAL).stale
    assert not study().computed(chapter, IDEAL).stale


def test_a_data_set_is_made_once(study):
    bench = study()
    assert not bench.is_driven("paper", IDEAL)
    assert bench.runs("paper", IDEAL) is bench.runs("paper", IDEAL)
    assert bench.is_driven("paper", IDEAL)
    assert study.source.made == ["paper ideal"]


def test_progress_reaches_who_asked(study):
    told = []
    bench = study(on_report=lambda *how_far: told.append(how_far))
    bench.report("folding", 1, 8)
    bench.runs("paper", IDEAL)
    assert told == [("folding", 1, 8), ("data paper, ideal sensors", 60, 60)]


def test_the_code_of_a_function_is_found_through_what_wraps_it():
    assert reached_code_digest(number_text) != reached_code_digest(cell_text)
    assert reached_code_digest(partial(number_text)) != reached_code_digest(partial(cell_text))
    assert reached_code_digest(StudyWorkbench.report) == reached_code_digest(StudyWorkbench.runs)


def test_what_a_function_is_given_beforehand_counts():
    def given(value: float) -> str:
        return reached_code_digest(partial(number_text, value=value))

    assert given(1.0) == given(1.0) != given(2.0)
    assert reached_code_digest(partial(map, number_text)) != reached_code_digest(partial(map, cell_text))
