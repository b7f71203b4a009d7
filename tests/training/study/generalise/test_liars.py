from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.study.desk import Desk
from training.study.chapter import Claim
from training.study.generalise import liars
from training.study.generalise.passages import Traffic, drawn_passages
from training.study.generalise.rules import MEDIAN, POSTERIOR, REFINED
from vehicle_client.simulator.plan import SensorGrade

BARELY_HIGH = liars.Strategy("", liars.all_say(1.1))
ABSURD = liars.Strategy("", liars.all_say(3.0))


def shift(strategy, liars_frac=0.3):
    return liars.mean_shift_ratio(strategy, liars.honest_windows(40, seed=3), liars_frac=liars_frac, seed=3)


def test_so_many_lie_and_the_rest_is_as_it_was(rng):
    honest = drawn_passages(rng, 50, mu_new=0.5, traffic=Traffic())
    lied = liars.with_liars(honest, BARELY_HIGH, rng, liars_frac=0.3)
    assert lied.mu[:15].tolist() == pytest.approx([0.55] * 15)
    assert lied.mu[15:].tolist() == honest.mu[15:].tolist()
    bounds = liars.with_liars(honest, liars.Strategy("", liars.all_say(2.0), at_least=True), rng, liars_frac=0.3)
    assert np.count_nonzero(bounds.at_least) == 15


def test_without_liars_nothing_shifts():
    assert shift(BARELY_HIGH, liars_frac=0.0) == dict.fromkeys(liars.COMPARED, 0.0)


def test_the_median_is_shifted_no_farther_than_the_bound():
    # Noise-free the shift is 11.1 eps / (1 - eps) per cent; noise and outliers add a little.
    for strategy in (BARELY_HIGH, ABSURD):
        assert abs(shift(strategy)[MEDIAN]) < 1.2 * 0.111 * 0.3 / 0.7


def test_absurd_lies_do_not_fool_the_posterior_and_likely_ones_do():
    assert abs(shift(ABSURD)[POSTERIOR]) < 0.01
    assert shift(BARELY_HIGH)[POSTERIOR] > 1.5 * shift(BARELY_HIGH)[MEDIAN]
    assert shift(BARELY_HIGH)[REFINED] < shift(BARELY_HIGH)[MEDIAN] + 0.045


@pytest.fixture
def result(monkeypatch):
    monkeypatch.setattr(liars, "QUICK_WINDOWS_COUNT", 8)
    monkeypatch.setattr(liars, "SWEEP_RATIO", np.array([0.7, 1.1, 1.5]))
    return liars.CHAPTER.compute(Desk(data_sets={}), SensorGrade.IDEAL)


def test_what_no_sensor_plays_a_part_in_is_computed_once_for_all_grades(monkeypatch):
    monkeypatch.setattr(liars, "QUICK_WINDOWS_COUNT", 8)
    desk = Desk(data_sets={})
    one, other = (liars.CHAPTER.compute(desk, grade) for grade in SensorGrade)
    assert one == other
    assert len(desk.worked) == len(set(desk.worked)) == 1


def test_the_chapter_tells_the_worst_of_each_rule(result):
    assert 0.03 < result.figures[f"worst_shift.{MEDIAN}"] < result.figures[f"worst_shift.{REFINED}"]
    assert result.figures["half_width_holds_frac"] == 1.0
    assert len(result.tables[0].rows) == len(liars.STRATEGIES) + 1
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)


@pytest.mark.parametrize(("median", "words"), [(0.05, "So the median is published"), (0.2, "deserves another look")])
def test_the_verdict_follows_the_figures(result, median, words):
    figures = {**result.figures, f"worst_shift.{MEDIAN}": median}
    told = liars.CHAPTER.verdict({SensorGrade.IDEAL: replace(result, figures=figures)})
    assert told.claim is Claim.NOT_CLAIMED
    assert words in told.text
