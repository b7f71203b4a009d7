from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.training.study.generalise.road_drives import FEW, SMALL_BEST, drives_on_roads
from training.accuracy import mape_ratio
from training.dataset import DatasetError
from training.fit_parameters import Target
from training.study.generalise.features import BestByGain
from training.study.recipes import Recipe
from training.study.tuning import FOLDS_COUNT, MOST_TREES_COUNT, Tuned, document_of, grounds_of, tune
from vehicle_client.simulator.plan import SensorGrade

pytestmark = pytest.mark.xdist_group("tuning")  # its fixtures take most of the time

IDEAL, AUTOMOTIVE = SensorGrade.IDEAL, SensorGrade.AUTOMOTIVE
FEATURES = ("grip_all_best_mu", "demand_q100_mu", "speed_mean_mps")
# One tree that hardly corrects anything: easy to better.
POOR_FIT = replace(FEW.parameters, trees_count=1, learning_rate_ratio=0.1)
POOR = Recipe("poor", FEATURES, replace(FEW, parameters=POOR_FIT))


def grounds(*, roads_count=8, seed=1):
    return {
        grade: grounds_of(drives_on_roads(20, seed=number), FEATURES, roads_count=roads_count, seed=seed)
        for number, grade in enumerate((IDEAL, AUTOMOTIVE))
    }


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    journal = tmp_path_factory.mktemp("search") / "deep" / "journal"
    told: list[tuple[int, float]] = []
    found = tune(POOR, grounds(), journal, trials_count=4, seed=1, on_trial=lambda *now: told.append(now))
    return found, told, journal


def test_the_roads_searched_on_and_the_others_are_all_there_are_and_none_is_both():
    runs = drives_on_roads(20)
    found = grounds_of(runs, ("section_length_m",), roads_count=8, seed=1)
    assert (found.roads_count, found.other_roads_count) == (8, 12)
    assert len(found.label_mu) + len(found.other_label_mu) == runs.usable.sum()
    lengths, others = (set(columns[:, 0].tolist()) for columns in (found.features, found.other_features))
    assert not lengths & others
    # All rows of a road in one fold.
    pairs = set(zip(found.features[:, 0].tolist(), found.fold.tolist(), strict=True))
    assert len(pairs) == 8
    assert {fold for _, fold in pairs} == set(range(FOLDS_COUNT))


def test_never_more_than_half_of_the_roads_are_searched_on():
    assert grounds_of(drives_on_roads(20), FEATURES, roads_count=500, seed=1).roads_count == 10


def test_too_few_roads_are_refused():
    with pytest.raises(DatasetError, match="too few"):
        grounds_of(drives_on_roads(4), FEATURES, roads_count=4, seed=1)


def test_the_search_begins_with_what_there_is_and_ends_no_worse(searched):
    found, told, _ = searched
    assert found.trials_count == 4
    assert [count for count, _ in told] == [1, 2, 3, 4]
    scores = [score for _, score in told]
    assert scores == sorted(scores, reverse=True)
    start = np.exp(np.mean([np.log(pair[0]) for pair in found.searched_mape_ratio.values()]))
    best = np.exp(np.mean([np.log(pair[1]) for pair in found.searched_mape_ratio.values()]))
    assert scores[-1] == pytest.approx(best)
    assert best < start
    assert found.improved


def test_a_search_goes_on_where_it_was(searched):
    found, _, journal = searched
    again = tune(POOR, grounds(), journal, trials_count=4, seed=1, on_trial=lambda *now: pytest.fail("searched again"))
    assert again == found
    more: list[int] = []
    longer = tune(POOR, grounds(), journal, trials_count=5, seed=1, on_trial=lambda count, _: more.append(count))
    assert more == [5]
    assert longer.trials_count == 5


def test_a_search_of_other_grounds_begins_anew(searched):
    _, _, journal = searched
    other = {IDEAL: grounds()[IDEAL]}
    assert tune(POOR, other, journal, trials_count=1, seed=1).trials_count == 1


def test_no_trial_begins_after_the_limit(tmp_path):
    # The first one always does: a search that found nothing has nothing to say.
    found = tune(POOR, grounds(), tmp_path / "journal", trials_count=50, limit_s=0.0, seed=1)
    assert found.trials_count == 1


def test_what_is_found_can_be_grown(searched):
    learn = searched[0].learn
    parameters, one = learn.parameters, grounds()[IDEAL]
    grown_mu = learn(one.features, one.label_mu)(one.features)
    guess_mu = np.full_like(one.label_mu, np.median(one.label_mu))
    assert mape_ratio(one.label_mu, grown_mu) < 0.5 * mape_ratio(one.label_mu, guess_mu)
    assert parameters.trees_count <= MOST_TREES_COUNT
    assert parameters.bins_count == POOR_FIT.bins_count
    assert searched[0].learn.relative == (parameters.target is not Target.LOG_MU)


def test_the_document_says_what_it_rests_on(searched):
    document = json.loads(json.dumps(document_of(searched[0], grounds(), seed=1)))
    assert document["grounds"]["ideal"]["roads_count"] == 8
    assert document["improved"] is True
    assert set(document["mape_ratio_on_other_roads"]["automotive"]) == {"start", "found"}


def test_settings_that_only_please_the_roads_searched_on_are_no_improvement():
    errors = {IDEAL: (0.05, 0.06), AUTOMOTIVE: (0.1, 0.099)}
    assert not Tuned(FEW, {}, errors, 3).improved


def test_what_is_not_boosted_is_not_searched(tmp_path):
    ranked = replace(SMALL_BEST, learn=BestByGain(FEW, 3))
    with pytest.raises(TypeError, match="boosted"):
        tune(ranked, grounds(), tmp_path / "journal", trials_count=1, seed=1)
