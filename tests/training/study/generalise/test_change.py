from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rsu_app.domain.change import ChangeKind
from tests.training.study.desk import Desk
from training.study.chapter import Claim
from training.study.generalise import change
from vehicle_client.simulator.plan import SensorGrade

HOUR_S = 3600.0


def drive(rng, course, rate=60):
    return change.driven(rng, course, from_s=-3.0 * HOUR_S, until_s=HOUR_S, vehicles_per_hour=rate)


def test_friction_changes_at_once_or_slowly():
    at_s = np.array([-1.0, 0.0, 1.5 * HOUR_S, 3.0 * HOUR_S, 9.0 * HOUR_S])
    assert change.sudden(0.5)(at_s).tolist() == [0.5, 0.25, 0.25, 0.25, 0.25]
    assert change.slow(0.25)(at_s) == pytest.approx([0.5, 0.5, 0.25, 0.125, 0.125])


def test_vehicles_come_in_the_order_of_their_times(rng):
    seen = drive(rng, change.sudden(0.5))
    assert (np.diff(seen.left_at_s) >= 0.0).all()
    assert len(seen.mu) == pytest.approx(240, abs=60)
    assert np.median(seen.mu / seen.mu_new) == pytest.approx(0.9, abs=0.02)


def test_a_drop_is_seen_and_no_rise(rng):
    seen = drive(rng, change.sudden(0.5))
    assert change.seen_after_count(seen, ChangeKind.DROP, memory_s=HOUR_S) in range(5, 12)
    assert change.seen_after_count(seen, ChangeKind.RISE, memory_s=HOUR_S) is None


def test_cutting_at_the_change_halves_the_error(rng):
    errors = change.mean_error_ratio(drive(rng, change.sudden(0.5)), from_s=0.0, until_s=HOUR_S)
    assert errors[change.CUT] < 0.5 * errors[change.PLAIN]
    assert errors[change.HALF] < errors[change.PLAIN]
    assert np.isnan(
        list(change.mean_error_ratio(drive(rng, change.sudden(0.5)), from_s=9e9, until_s=9e9).values())
    ).all()


def test_without_a_change_all_publish_the_same(rng):
    seen = drive(rng, change.sudden(1.0))
    said = change.published_mu(seen.left_at_s, seen.mu, now_s=HOUR_S)
    assert said[change.PLAIN] == said[change.CUT] == said[change.REMEMBERING]


def test_no_vehicle_no_middle():
    said = change.published_mu(np.zeros(0), np.zeros(0), now_s=0.0)
    assert np.isnan(list(said.values())).all()


def test_a_quiet_month_is_quiet_and_liars_make_it_loud(rng):
    quiet = change.false_alarms_count(rng, vehicles_count=20_000, noise_ratio=0.05, liars_frac=0.0)
    loud = change.false_alarms_count(rng, vehicles_count=20_000, noise_ratio=0.05, liars_frac=0.3)
    assert quiet == {ChangeKind.DROP: 0, ChangeKind.RISE: 0}
    assert loud[ChangeKind.DROP] > 5


@pytest.fixture(scope="module")
def small():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(change, "QUICK_RUNS_COUNT", 2)
        patch.setattr(change, "VEHICLES_PER_HOUR", (10, 60))
        patch.setattr(change, "MONTH_HOURS", 20)
        patch.setattr(change, "SLOW_HOURS", 0.5)
        yield


@pytest.fixture(scope="module")
def result(small):
    return change.CHAPTER.compute(Desk(data_sets={}), SensorGrade.IDEAL)


def test_the_chapter_has_its_tables(result):
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)
    assert len(result.tables[2].rows) == len(change.NOISES_RATIO) * len(change.LIARS_FRAC)
    assert result.figures["drop_to_40.60.unseen_frac"] == 0.0


def test_what_no_sensor_plays_a_part_in_is_computed_once_for_all_grades(small):
    desk = Desk(data_sets={})
    one, other = (change.CHAPTER.compute(desk, grade) for grade in SensorGrade)
    assert one.figures == pytest.approx(other.figures, nan_ok=True)
    assert sorted(desk.worked) == ["change-1", "change-picture-1"]


@pytest.mark.parametrize(("quiet", "words"), [(0.0, "does what it is for"), (5.0, "not yet fit for use")])
def test_the_verdict_follows_the_figures(result, quiet, words):
    seen = {f"drop_to_{left}.60.unseen_frac": 0.0 for left in (80, 60, 40)}
    figures = {**result.figures, **seen, "false_alarms.noise5.liars0.drop": quiet}
    told = change.CHAPTER.verdict({SensorGrade.IDEAL: replace(result, figures=figures)})
    assert told.claim is Claim.NOT_CLAIMED
    assert words in told.text
