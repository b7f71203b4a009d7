"""The object that machines read: everything that must be there is, and what is wrong is said."""

import json
import math

import pytest

from tests.training.study.fake_chapters import fake_chapter
from training.study.chapter import Result
from training.study.finding import Computed, Finding, Timing
from training.study.headlines import HEADLINES, summary
from vehicle_client.simulator.plan import SensorGrade

IDEAL, AUTOMOTIVE = SensorGrade.IDEAL, SensorGrade.AUTOMOTIVE
NAMED_BY_THE_STUDY = """
known_worst_mape cv_median_mape sfs15_mape relative_rms unseen_roads_mape unseen_roads_mape_80 unseen_roads_mape_util60
unseen_fleet_mape interval50_worst_known interval10_worst_known_best interval50_worst_unseen extreme_flagged_frac
normal_flagged_frac unseen_flagged_frac
""".split()


def finding_of(name: str, **figures: float) -> Finding:
    result = Result({key.replace("__", "."): value for key, value in figures.items()}, {"rows_count": 7})
    return Finding(
        fake_chapter(name), {IDEAL: Computed(result, Timing(60.0, 100.0), "abc", {"paper ideal": "d"})}, None
    )


def summary_of(*findings: Finding):
    return summary(findings, seed=1, quick=False, version="1")


def test_all_names_are_there_whether_found_or_not():
    assert [headline.name for headline in HEADLINES] == NAMED_BY_THE_STUDY
    document = summary_of()
    for grade in SensorGrade:
        for config in ("paper_config", "best"):
            assert set(NAMED_BY_THE_STUDY) <= set(document[grade.value][config])
            assert set(document[grade.value][config].values()) == {None}
    assert "automotive.best.unseen_roads_mape" in document["missing"]
    json.dumps(document, allow_nan=False)


def test_a_figure_of_a_chapter_becomes_a_headline_of_its_grade():
    document = summary_of(finding_of("a", headline__best__unseen_roads_mape=0.0251, mape=3.0))
    assert document["ideal"]["best"]["unseen_roads_mape"] == 0.0251
    assert document["automotive"]["best"]["unseen_roads_mape"] is None
    assert "ideal.best.unseen_roads_mape" not in document["missing"]
    assert document["chapters"]["a"]["ideal"]["sizes"] == {"rows_count": 7}
    assert document["chapters"]["a"]["ideal"]["data_digests"] == {"paper ideal": "d"}
    assert document["wall_s"] == 60


def test_a_figure_that_is_no_number_counts_as_missing():
    document = summary_of(finding_of("a", headline__best__relative_rms=math.nan))
    assert document["ideal"]["best"]["relative_rms"] is None
    assert "ideal.best.relative_rms" in document["missing"]


def test_the_speed_alone_stands_beside_where_a_chapter_has_it():
    document = summary_of(finding_of("a", headline__speed_only__relative_rms=0.2))
    assert document["ideal"]["speed_only"] == {"relative_rms": 0.2}
    assert document["automotive"]["speed_only"] == {}


def test_two_chapters_with_one_headline_are_named():
    document = summary_of(
        finding_of("a", headline__best__relative_rms=0.1), finding_of("b", headline__best__relative_rms=0.2)
    )
    assert document["ideal"]["best"]["relative_rms"] == 0.1
    assert document["contested"] == ["ideal.best.relative_rms: a, b"]


def test_a_headline_of_no_configuration_is_named():
    assert summary_of(finding_of("a", headline__bset__relative_rms=0.1))["unknown"] == ["bset.relative_rms"]


def test_failures_are_defects():
    failed = Finding(fake_chapter("a"), {}, None, {"ideal": "ValueError: no"})
    assert summary_of(failed)["defects"] == ["a, ideal: ValueError: no"]


@pytest.mark.parametrize(
    ("name", "value", "reached"),
    [
        ("unseen_roads_mape", 0.065, True),
        ("unseen_roads_mape", 0.066, False),
        ("extreme_flagged_frac", 0.94, False),
        ("extreme_flagged_frac", 0.96, True),
        ("unseen_roads_mape", None, None),
    ],
)
def test_targets_are_met_from_their_own_side(name, value, reached):
    (headline,) = (each for each in HEADLINES if each.name == name)
    assert headline.is_reached(value, AUTOMOTIVE) is reached
