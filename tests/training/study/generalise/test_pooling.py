from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from training.study.batches import CellErrors
from training.study.chapter import Claim
from training.study.generalise import held_out, pooling
from training.study.generalise.passages import Traffic
from training.study.generalise.rules import MEDIAN, REFINED
from training.study.recipes import PAPER_FIT, PAPER_RECIPE, Boosted
from vehicle_client.simulator.plan import SensorGrade

FEW = Boosted(replace(PAPER_FIT, trees_count=8, depth_count=3, bins_count=16))
SMALL = replace(PAPER_RECIPE, name="small", learn=FEW)


def cell_errors(*, answered_frac=1.0, p95_ratio=0.1, road="bend"):
    nothing = np.nan if answered_frac == 0.0 else p95_ratio
    return CellErrors(road, 0.5, 40, 10, 20, answered_frac, nothing, nothing, nothing, nothing)


def test_more_vehicles_err_less_and_the_refined_interval_least():
    found = pooling.simulated(Traffic(), windows_count=60, seed=1)
    assert found[MEDIAN, 100] < found[MEDIAN, 10] < found[MEDIAN, 1]
    assert found[REFINED, 50] < found[MEDIAN, 50]


def test_a_half_width_that_knows_of_shared_errors_holds_more_often():
    widened, plain = (pooling.held_frac(plain, windows_count=200, seed=1) for plain in (False, True))
    assert widened > 0.9
    assert plain < 0.7


def test_every_run_has_a_passage_or_nothing_and_none_is_a_bound():
    runs = made_up_runs(40)
    rows = np.flatnonzero(runs.usable)
    judged = held_out.HeldOut(runs, rows, np.zeros_like(rows), np.full(len(rows), -0.1), np.full(len(rows), 0.05))
    said = pooling.passages_of(judged)
    assert np.array_equal(np.isfinite(said.mu), runs.usable)
    assert (said.mu[rows] > 0.0).all()
    assert said.expected_error_ratio[rows].tolist() == judged.expected_error_ratio.tolist()
    assert not said.at_least.any()


def test_what_is_not_answered_is_no_error():
    judged = pooling.judged_of((cell_errors(), cell_errors(answered_frac=0.0, road="silent")))
    assert (judged.worst.road, judged.mean_ratio, judged.answered_frac) == ("bend", 0.1, 0.5)
    silent = pooling.judged_of((cell_errors(answered_frac=0.0),))
    assert np.isnan(silent.mean_ratio)
    assert np.isnan(silent.worst.p95_ratio)


@pytest.fixture(scope="module")
def result():
    roads = made_up_runs(300, seed=5)
    named = replace(roads, section_id=tuple(f"road-{i % 24}" for i in range(300)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pooling, "QUICK_WINDOWS_COUNT", 10)
        patch.setattr(pooling, "QUICK_BATCHES_COUNT", 4)
        patch.setattr(pooling, "SIMULATED_SIZES_COUNT", (1, 50))
        patch.setattr(pooling, "DRIVEN_SIZES_COUNT", (10, 50))
        patch.setattr(held_out, "EXPECTED_ERROR", FEW)
        patch.setattr(pooling, "CONFIGS", {"paper_config": SMALL, "best": SMALL})
        two = replace(made_up_runs(60, seed=6), section_id=tuple(f"two-{i % 6}" for i in range(60)))
        sets = {"paper": made_up_runs(300), "random-roads": named, "random-roads-two-frictions": two}
        desk = Desk(data_sets=sets)
        return pooling.CHAPTER.compute(desk, SensorGrade.IDEAL)


def test_the_chapter_gives_its_headlines(result):
    figures = result.figures
    assert (
        figures["headline.paper_config.interval10_worst_known_best"]
        == figures[f"known.paper_config.{REFINED}.10.worst_p95"]
    )
    assert figures["headline.best.interval50_worst_known"] == figures[f"known.best.{MEDIAN}.50.worst_p95"]
    assert "headline.paper_config.interval50_worst_known" not in figures, "another chapter's"
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)


def test_the_verdict_follows_the_figures(result):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pooling, "CONFIGS", {"paper_config": SMALL, "best": SMALL})
        for where in ("known", "unseen"):
            figures = {**result.figures, f"{where}.best.{MEDIAN}.50.worst_p95": 0.4321}
            told = pooling.CHAPTER.verdict({SensorGrade.IDEAL: replace(result, figures=figures)})
            assert told.claim is Claim.NOT_CLAIMED
            assert "43.2 % (ideal) by the median" in told.text


def test_the_verdict_says_so_where_nothing_is_named(result):
    name = f"unseen.best.{pooling.BOUNDED}.50"
    nothing = {f"{name}.answered_frac": 0.0, f"{name}.worst_p95": np.nan}
    told = pooling.CHAPTER.verdict({SensorGrade.IDEAL: replace(result, figures={**result.figures, **nothing})})
    assert "no batch has enough that name a friction" in told.text
    assert "nan" not in told.text
