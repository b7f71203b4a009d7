"""The chapter on the closed loop, with made-up drives and small regressors."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from roadgrip.sections import read_section
from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from training import cars, everyday
from training.closed_loop import Passed
from training.designs import PAPER_ROADS
from training.study.chapter import Claim
from training.study.documents import document_of, result_of
from training.study.generalise import closed_loop as chapter
from training.study.generalise import loop_model
from training.study.generalise.loop_cases import (
    BEST,
    BOXED,
    HELD,
    HELD_CUT,
    LIKELIHOODS,
    MEDIAN,
    PHASE_NAMES,
    QUICK_SETTINGS,
    SETTINGS,
    TEACHINGS,
    Setting,
)
from training.study.generalise.loop_model import DATA_SETS
from training.study.generalise.loop_vehicles import schooled_cars, terms_of, travellers
from training.study.recipes import PAPER_FIT, Boosted
from vehicle_client.simulator.plan import SensorGrade

FEW = Boosted(replace(PAPER_FIT, trees_count=8, depth_count=3, bins_count=16))
GRADE = SensorGrade.IDEAL


def made_up_drives(_section, _terms, *, memories):
    """Return what drives plans: any features that go with the friction."""
    assert not memories, "exact sensors leave nothing to remember"
    runs = made_up_runs(400, seed=9)
    rows, label_mu = runs.features[runs.usable], runs.labels["label_mu"][runs.usable]

    def drive(plans):
        found_mu = [plan.base_friction_mu * plan.wear_factor for plan in plans]
        nearest = [int(np.abs(label_mu - mu).argmin()) for mu in found_mu]
        return [
            Passed(
                row=None if plan.seed % 20 == 0 else rows[i],
                kept_to_road=plan.seed % 20 != 0,
                duration_s=20.0,
                label_mu=mu,
                mean_speed_mps=15.0,
                peak_utilisation_ratio=0.5,
            )
            for plan, mu, i in zip(plans, found_mu, nearest, strict=True)
        ]

    return drive


@pytest.fixture(scope="module")
def result():
    random = [f"random-{i}" for i in range(8)]
    runs = {
        name: replace(
            made_up_runs(200, seed=seed),
            section_id=tuple((*PAPER_ROADS, *random)[i % 11] for i in range(200)),
        )
        for seed, name in enumerate(DATA_SETS)
    }
    small = tuple(replace(one, recipe=replace(one.recipe, learn=FEW)) for one in TEACHINGS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop_model, "EXPECTED_ERROR", FEW)
        patch.setattr(chapter, "TEACHINGS", small)
        patch.setattr(chapter, "simulated", made_up_drives)
        patch.setattr(chapter, "QUICK_VEHICLES_PER_HOUR", 12.0)
        yield chapter.CHAPTER.compute(Desk(data_sets=runs), GRADE)


def test_every_setting_is_measured_in_every_phase(result):
    for setting in QUICK_SETTINGS:
        for phase in PHASE_NAMES:
            assert 0.0 <= result.figures[f"{setting.name}.{phase}.worst_left_road"] <= 1.0
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)
    assert result.pictures[0].lines[0].name == "truth"
    assert all(len(line.x) == len(line.y) for picture in result.pictures for line in picture.lines)
    assert result_of(document_of(result)).sizes == result.sizes


def told(result, changed):
    return chapter.CHAPTER.verdict({GRADE: replace(result, figures={**result.figures, **changed})})


def test_the_verdict_says_whether_a_lie_comes_true(result):
    lies = [s for s in QUICK_SETTINGS if s.told_ratio != 1.0]
    for drift, words in ((0.5, "confirms itself (+50 % towards"), (0.0, "does not confirm itself (+0 % towards")):
        changed = {f"{s.name}.{phase}.claimed_towards_lie": drift for s in lies for phase in PHASE_NAMES}
        said = told(result, changed)
        assert said.claim is Claim.NOT_CLAIMED
        assert words in said.text
    changed = {f"{s.name}.{phase}.claimed_towards_lie": np.nan for s in lies for phase in PHASE_NAMES}
    assert "no friction is claimed" in told(result, changed).text


def test_the_verdict_says_whether_obedient_drivers_count(result):
    for share, words in ((1.0, "they stay inside the envelope"), (0.5, "still too few")):
        changed = {
            f"{s.name}.{phase}.least_counted": share
            for s in QUICK_SETTINGS
            if s.teaching in {BEST, BOXED}
            for phase in PHASE_NAMES
        }
        assert words in told(result, changed).text


def test_the_verdict_says_when_units_are_blind(result):
    blind = Setting(BEST, MEDIAN, 1.0).name
    for bias, words in ((1.0, "the less the unit knows"), (0.01, "still use enough of the grip")):
        assert words in told(result, {f"{blind}.{phase}.worst_bias": bias for phase in PHASE_NAMES}).text
    late = Setting(BEST, HELD_CUT, 0.5).name
    assert f"never ({HELD_CUT}, {GRADE})" in told(result, {f"{late}.slippery.worst_lag_s": np.nan}).text
    assert f"20 min ({HELD_CUT}, {GRADE})" in told(result, {f"{late}.slippery.worst_lag_s": 1200.0}).text


def test_the_verdict_says_whether_advice_is_locked_in_and_whether_holding_it_helps(result):
    def with_advice(median, held, *, fastest=1.0):
        changed: dict[str, float] = {}
        for rule, slowest in ((MEDIAN, median), (HELD, held), (HELD_CUT, held)):
            for phase in PHASE_NAMES:
                name = f"{Setting(BEST, rule, 1.0).name}.{phase}"
                changed |= {f"{name}.slowest_advice": slowest, f"{name}.fastest_advice": fastest}
        return told(result, changed).text

    assert "falls to 0.50 of the right speed at worst, locked in by its own slowness" in with_advice(0.5, 0.9)
    assert "it gets out of it: 0.90 to 1.00" in with_advice(0.5, 0.9)
    assert "it is still too slow" in with_advice(0.5, 0.6)
    assert "it stays fast enough" in with_advice(0.9, 0.9)
    assert "never much above it" in with_advice(0.5, 0.9)
    assert "at times dangerously above it" in with_advice(0.5, 0.9, fastest=1.3)


def test_a_quick_study_drives_settings_of_the_whole_one():
    assert set(QUICK_SETTINGS) <= set(SETTINGS)
    assert len(set(SETTINGS)) == len(SETTINGS)
    for settings in (QUICK_SETTINGS, SETTINGS):
        assert {s.right for s in settings} <= set(settings)
    assert Setting(BEST, LIKELIHOODS, 1.0) in SETTINGS


def test_the_unit_as_it_is_has_a_line_for_each_road_and_compliance(result):
    table = result.tables[0]
    assert table.title == "A road side unit as it is"
    assert {row[:2] for row in table.rows} == {
        (rule, share) for rule in (HELD, HELD_CUT) for share in (0.0, 50.0, 100.0)
    }


def test_cars_learn_before_the_roads_are_driven_side_by_side(monkeypatch):
    learned_in = []

    def learn(_bench, _grade):
        learned_in.append(threading.current_thread())
        return {}

    monkeypatch.setattr(chapter, "QUICK_ROADS", chapter.ROADS)
    monkeypatch.setattr(chapter, "schooled_cars", learn)
    monkeypatch.setattr(chapter, "loop_models", lambda *_: dict.fromkeys(teaching.name for teaching in TEACHINGS))
    monkeypatch.setattr(chapter, "closed_loop", lambda *_, **__: {})
    assert set(chapter.courses(Desk(data_sets={}), SensorGrade.AUTOMOTIVE)) == set(chapter.ROADS)
    assert learned_in == [threading.main_thread()]


@pytest.mark.sim
@pytest.mark.xdist_group("sim")
def test_cars_of_the_loop_learn_once_and_come_again(monkeypatch):
    monkeypatch.setattr(everyday, "EVERYDAY_COUNT", 1)
    monkeypatch.setattr(cars, "CARS_COUNT", 2)
    desk = Desk(data_sets={})
    learned = schooled_cars(desk, SensorGrade.AUTOMOTIVE)
    assert len(learned) == 2
    assert any(memory.passages_count == 1 for memory in learned.values())
    assert schooled_cars(desk, SensorGrade.AUTOMOTIVE) == learned
    coming = travellers(
        read_section("s-turn"),
        phases_mu=(0.5,),
        phase_s=3600.0,
        vehicles_per_hour=40.0,
        terms=terms_of(1, SensorGrade.AUTOMOTIVE),
        sensor_seeds=tuple(learned),
    )
    assert {one.plan.sensor_seed for one in coming} == set(learned)
