"""The page of the onboard client's accuracy, and what others cite of it, against the kept figures."""

import json
from collections import Counter

import numpy as np
import pytest

from bench.onboard.chapters import CHAPTERS
from bench.onboard.positions import Placed, Tally, error_figures
from bench.onboard_accuracy import FIGURES_PATH, PAGE, PAGES, page_with_tables
from training.marked_tables import marks_of

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def figures():
    return json.loads(FIGURES_PATH.read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_holds_the_kept_figures(page, figures):
    text = page.read_text(encoding="utf-8")
    assert page_with_tables(text, figures) == text


def test_every_chapter_has_figures_and_a_table(figures):
    told = {name.partition(".")[0] for page in PAGES for name in marks_of(page.read_text(encoding="utf-8"))}
    assert list(figures) == list(CHAPTERS)
    assert set(CHAPTERS) <= told


def test_every_picture_of_the_study_is_on_the_page(figures):
    def pictures(value):
        if isinstance(value, dict):
            for key, inner in value.items():
                if key.endswith("picture"):
                    yield inner
                elif key == "pictures":
                    yield from inner
                else:
                    yield from pictures(inner)

    names = list(pictures(figures))
    assert names
    page = PAGE.read_text(encoding="utf-8")
    assert [name for name in names if not (FIGURES_PATH.parent / name).is_file()] == []
    assert [name for name in names if f"results/onboard/{name}" not in page] == []


def placed(*exits_m, stated_std_m=1.0):
    return [Placed(entry_error_m=0.5, exit_error_m=e, along_rms_m=0.1, stated_std_m=stated_std_m) for e in exits_m]


def test_position_errors_count_by_size():
    found = error_figures(placed(-3.0, 1.0, 2.0))
    assert found["exit_q50_m"] == 2.0
    assert found["exit_largest_m"] == 3.0
    assert found["exit_within_two_stated_frac"] == pytest.approx(2.0 / 3.0)
    assert found["entry_within_two_stated_frac"] == 1.0


def test_normal_errors_of_the_stated_size_are_covered_as_they_should():
    rng = np.random.default_rng(3)
    found = error_figures(placed(*rng.normal(0.0, 2.0, 4000), stated_std_m=2.0))
    assert found["exit_within_two_stated_frac"] == pytest.approx(0.954, abs=0.01)


def test_tallies_add_up():
    both = Tally(placed(1.0), Counter(wrong_road=1), 2, 1) + Tally(placed(2.0, 3.0), Counter(wrong_road=2), 1, 0)
    assert both.completed_count == 6
    assert both.reasons == {"wrong_road": 3}
    assert (both.unfinished_count, both.unfinished_taken_count) == (3, 1)
