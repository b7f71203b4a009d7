"""Models of the closed loop judge as a unit does, and by what they had not seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE, PAPER_TABLE
from roadgrip.records import NotCounted
from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from training.designs import PAPER_ROADS
from training.study.generalise import loop_model as of_loop
from training.study.generalise.loop_model import (
    ANY_SPEED_SET,
    DATA_SETS,
    USUAL_SETS,
    Teaching,
    gathered,
    loop_model,
    loop_models,
    strangers_answers,
    what_is_taught,
)
from training.study.recipes import PAPER_FIT, PAPER_RECIPE, Boosted
from vehicle_client.simulator.plan import SensorGrade

FEW = Boosted(replace(PAPER_FIT, trees_count=8, depth_count=3, bins_count=16))
SMALL = replace(PAPER_RECIPE, name="small", learn=FEW)
GRADE = SensorGrade.IDEAL


def roads(count, names, *, seed, shift=0.0):
    runs = made_up_runs(count, seed=seed)
    features = runs.features.copy()
    features[:, 1] += shift
    return replace(runs, features=features, section_id=tuple(names[i % len(names)] for i in range(count)))


@pytest.fixture(scope="module")
def desk():
    random = [f"random-{i}" for i in range(16)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(of_loop, "EXPECTED_ERROR", FEW)
        yield Desk(
            data_sets={
                "paper": roads(200, PAPER_ROADS, seed=1),
                "random-roads": roads(300, random, seed=2),
                ANY_SPEED_SET: roads(200, [*PAPER_ROADS, *random], seed=3, shift=5.0),
            }
        )


def test_a_random_road_is_judged_by_those_that_know_nothing_of_it(desk):
    drives = gathered(desk, GRADE)
    section = np.array(drives.runs.section_id)
    assert all(len(set(drives.fold[section == f"random-{i}"].tolist())) == 1 for i in range(16))
    assert len(set(drives.fold[section == PAPER_ROADS[0]].tolist())) == of_loop.FOLDS_COUNT
    assert drives.of(*USUAL_SETS).sum() == 450
    assert drives.runs.usable.all()


def test_drives_that_are_not_taught_are_judged_too(desk):
    judged = strangers_answers(desk, GRADE, Teaching("usual", SMALL, USUAL_SETS))
    assert np.isfinite(judged.mu).all()
    assert (judged.expected_error_ratio > 0.0).all()


def test_what_lies_outside_of_what_was_taught_does_not_count_until_it_is_taught(desk):
    drives = gathered(desk, GRADE)
    rows = drives.runs.features[drives.of(ANY_SPEED_SET)]
    outside = {
        sets: np.mean(
            [said.flags is not NotCounted.NONE for said in loop_model(desk, GRADE, Teaching("x", SMALL, sets))(rows)]
        )
        for sets in (USUAL_SETS, DATA_SETS)
    }
    assert outside[DATA_SETS] < 0.1
    usual, whole = (what_is_taught(desk, GRADE, Teaching("x", SMALL, sets)) for sets in (USUAL_SETS, DATA_SETS))
    assert whole.outside_box_frac[ANY_SPEED_SET] <= usual.outside_box_frac[ANY_SPEED_SET]
    assert usual.strange_frac[ANY_SPEED_SET] >= whole.strange_frac[ANY_SPEED_SET]


def test_a_model_says_what_its_regressors_say_whatever_else_comes_with_it(desk):
    model = loop_model(desk, GRADE, Teaching("usual", SMALL, USUAL_SETS))
    drives = gathered(desk, GRADE)
    rows = drives.runs.features[:5]
    said = model(rows)
    assert [one.mu for one in said] == pytest.approx(model.friction(drives.runs.columns(SMALL.features)[:5]).tolist())
    assert [one.mu for one in model(rows[::-1])] == [one.mu for one in said][::-1]
    assert all(one.mu_low is not None and one.mu is not None and one.mu_low < one.mu for one in said)
    assert model.manifest.feature_names == PAPER_TABLE.names
    assert len(NEWEST_TABLE) > len(PAPER_TABLE)


def test_models_that_only_differ_by_their_envelope_are_taught_once(desk):
    whole, boxed = Teaching("whole", SMALL, USUAL_SETS), Teaching("boxed", SMALL, USUAL_SETS, in_a_box=True)
    models = loop_models(desk, GRADE, (whole, boxed))
    assert models["boxed"].friction is models["whole"].friction
    assert models["whole"].manifest.ordinary is not None
    assert models["boxed"].manifest == replace(models["whole"].manifest, ordinary=None)
    assert loop_models(desk, GRADE, (boxed,))["boxed"].manifest.ordinary is None


def test_large_data_sets_are_thinned_by_chance_and_always_alike(desk):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(of_loop, "MOST_DRIVES_COUNT", 50)
        few, again = gathered(desk, GRADE), gathered(desk, GRADE)
    assert [int(few.of(name).sum()) for name in DATA_SETS] == [50, 50, 50]
    assert few.runs.run_key == again.runs.run_key
    assert set(few.runs.run_key) <= set(gathered(desk, GRADE).runs.run_key)
