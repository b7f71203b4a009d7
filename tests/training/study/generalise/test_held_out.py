from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.training.study.generalise.road_drives import FEW, SMALL_BEST, road_desk
from training.study.generalise import held_out as made
from training.study.generalise.held_out import (
    UTILISATION_BANDS,
    band_name,
    band_of,
    held_out,
    left_out_roads,
    mean_by_road,
    on_known_roads,
    on_other_roads,
    surest,
)
from training.study.recipes import Recipe
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
LENGTH = ("section_length_m",)


@pytest.fixture(autouse=True)
def quick_expectations(monkeypatch):
    monkeypatch.setattr(made, "EXPECTED_ERROR", FEW)


@dataclass(frozen=True, slots=True)
class KnowsRoads:
    """Says 0.2 on roads it has seen, which it knows by their length, and 0.4 on others."""

    def __call__(self, features, label_mu):
        seen = set(features[:, 0].tolist())
        return lambda rows: np.array([0.2 if length in seen else 0.4 for length in rows[:, 0].tolist()])


RECOGNISES = Recipe("recognises", LENGTH, KnowsRoads())


@pytest.mark.parametrize("judge", [held_out, left_out_roads])
def test_nobody_judges_a_road_he_has_seen(judge):
    assert set(judge(road_desk(), IDEAL, RECOGNISES).mu.tolist()) == {0.4}


def test_the_papers_roads_are_judged_by_those_who_know_random_ones():
    found = on_other_roads(road_desk(), IDEAL, RECOGNISES, data_set="paper")
    assert set(found.mu.tolist()) == {0.4}
    found = on_other_roads(road_desk(), IDEAL, RECOGNISES, data_set="random-roads")
    assert set(found.mu.tolist()) == {0.2}


def test_every_passage_with_a_summary_is_judged_once():
    found = held_out(road_desk(), IDEAL, SMALL_BEST)
    assert sorted(found.rows.tolist()) == np.flatnonzero(found.runs.usable).tolist()
    assert len({(road, fold) for road, fold in zip(found.roads, found.fold.tolist(), strict=True)}) == 48


def test_where_less_grip_was_used_more_error_is_expected():
    found = held_out(road_desk(), IDEAL, SMALL_BEST)
    assert (found.expected_error_ratio > 0.0).all()
    assert np.corrcoef(found.expected_error_ratio, found.utilisation_ratio)[0, 1] < -0.3
    assert found.expected_error_ratio.mean() == pytest.approx(np.abs(found.log_ratio).mean(), rel=0.3)


def test_nothing_is_judged_where_nobody_drove():
    found = on_other_roads(road_desk(), IDEAL, SMALL_BEST, data_set="ringebu")
    assert len(found) == 0
    assert found.roads == ()


@dataclass(frozen=True, slots=True)
class ByHeart:
    """Knows every row it has seen, and says 0.3 of all others."""

    def __call__(self, features, label_mu):
        seen = {row.tobytes(): mu for row, mu in zip(features, label_mu, strict=True)}
        return lambda rows: np.array([seen.get(row.tobytes(), 0.3) for row in rows])


def test_on_a_known_road_the_drive_is_still_a_stranger():
    found = on_known_roads(road_desk(), IDEAL, Recipe("by heart", SMALL_BEST.features, ByHeart()))
    assert found.mu.tolist() == [0.3] * len(found)
    assert found.rows.tolist() == np.flatnonzero(found.runs.usable).tolist()


def test_the_error_to_expect_on_a_known_road_is_about_what_is_found():
    found = on_known_roads(road_desk(), IDEAL, SMALL_BEST)
    assert found.expected_error_ratio.mean() == pytest.approx(np.abs(found.log_ratio).mean(), rel=0.3)


def test_errors_to_expect_are_positive_and_follow_what_they_are_learned_from(rng):
    size = rng.uniform(0.01, 0.2, 2000)
    features = np.column_stack([size, rng.normal(size=2000)])
    expected = made.ErrorTrees()(features, size * np.abs(rng.standard_normal(2000)))(features)
    assert (expected > 0.0).all()
    assert np.corrcoef(expected, size)[0, 1] > 0.9


def test_every_run_of_the_data_set_has_a_value_or_nothing():
    found = held_out(road_desk(), IDEAL, SMALL_BEST)
    mu = found.of_all_runs(found.mu)
    assert np.array_equal(np.isfinite(mu), found.runs.usable)
    assert mu[found.rows].tolist() == found.mu.tolist()
    assert np.array_equal(found.of_all_runs(np.column_stack([found.mu, found.mu]))[:, 1], mu, equal_nan=True)


def test_a_part_keeps_what_belongs_together():
    found = held_out(road_desk(), IDEAL, SMALL_BEST)
    used = found.utilisation_ratio > 0.8
    part = found.part(used)
    assert part.error_ratio.tolist() == found.error_ratio[used].tolist()
    assert part.column("demand_q100_mu").tolist() == found.column("demand_q100_mu")[used].tolist()
    assert part.mape_ratio == pytest.approx(part.error_ratio.mean())


def test_estimates_that_are_no_friction_still_have_an_error():
    found = held_out(road_desk(), IDEAL, SMALL_BEST)
    lost = replace(found, mu=np.full(len(found), -0.1))
    assert np.isfinite(lost.log_ratio).all()
    assert (lost.error_ratio > 1.0).all()


def test_a_mean_by_road_weighs_every_road_the_same():
    assert mean_by_road(np.array([1.0, 3.0, 10.0]), ("a", "a", "b")).tolist() == [2.0, 10.0]


@given(
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40),
    st.floats(0.01, 1.0),
)
def test_the_surest_are_as_many_as_asked_for_and_none_is_less_sure(expected, kept_frac):
    values = np.array(expected)
    kept = surest(values, kept_frac=kept_frac)
    assert kept_frac * len(values) - 1e-6 <= kept.sum() <= kept_frac * len(values) + 1.0
    if not kept.all():
        assert values[kept].max() <= values[~kept].min()


def test_every_utilisation_falls_into_one_band():
    values = np.array([0.0, 0.3, 0.35, 0.4, 0.59, 0.6, 0.8, 1.2])
    assert np.sum([band_of(values, band) for band in UTILISATION_BANDS], axis=0).tolist() == [1] * len(values)


def test_bands_read_as_people_say_them():
    assert [band_name(band) for band in UTILISATION_BANDS] == [
        "below 0.3",
        "0.3 to 0.4",
        "0.4 to 0.6",
        "0.6 to 0.8",
        "0.8 and more",
    ]
    assert band_name((35.0, 70.0), unit="m") == "35 to 70 m"
    assert band_name((140.0, np.inf), unit="m") == "140 m and more"
