"""The chapter on cars: strangers judge whole groups, every telling the same passages, and the verdict follows."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.study.desk import Desk
from tests.training.study.generalise.road_drives import SMALL_BEST, drives_on_roads
from training.car_lives import Telling
from training.dataset import Runs, joined
from training.study.generalise import vehicles
from training.study.generalise.vehicles import EXACT, FLEET_SET, LIKE, PAPER_CAR_SET, Estimated, key_of
from training.study.recipes import PAPER_FIT, PAPER_RECIPE, SPEED_ONLY_RECIPE, Boosted
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
BETTER = {
    Telling.MATCHED: 0.05,
    Telling.REMEMBERED: 0.03,
    Telling.WRONG: 0.4,
    Telling.IDENTIFIED_FEW: 0.2,
    Telling.IDENTIFIED: 0.06,
}


def lives(groups_count=6, *, noise=BETTER) -> Runs:
    """Return made-up passages of some groups, told with more or less noise."""
    parts = []
    for telling in Telling:
        runs = drives_on_roads(11 * groups_count, shy_noise=noise[telling], seed=3)
        keys = tuple(f"lives/{i // 121:04d}-{i % 11:02d}/{i // 11 % 11:02d}/{telling}" for i in range(len(runs)))
        parts.append(replace(runs, scenario=(telling.value,) * len(runs), run_key=keys))
    return joined(parts)


@pytest.fixture
def bench(monkeypatch):
    few = Boosted(replace(PAPER_FIT, trees_count=5, depth_count=2))
    monkeypatch.setattr(vehicles, "BEST_RECIPE", SMALL_BEST)
    monkeypatch.setattr(
        vehicles,
        "BASELINES",
        {"paper_config": replace(PAPER_RECIPE, learn=few), "speed_only": replace(SPEED_ONLY_RECIPE, learn=few)},
    )
    return Desk({FLEET_SET: lives(), PAPER_CAR_SET: lives(4)})


def test_every_telling_is_judged_on_the_same_passages():
    runs = lives(2)
    broken = runs.features.copy()
    one = np.flatnonzero(np.array(runs.scenario) == Telling.WRONG.value)[5]
    broken[one] = np.nan
    rows = vehicles.rows_by_telling(replace(runs, features=broken))
    passages = {tuple(runs.run_key[i].rpartition("/")[0] for i in mine.tolist()) for mine in rows.values()}
    assert len(passages) == 1
    assert runs.run_key[one].rpartition("/")[0] not in passages.pop()


def test_a_group_is_told_by_its_runs_name():
    assert vehicles.group_of("lives-fleet/0012-03/07/matched") == "0012"


def test_the_chapter_tells_what_wrong_constants_cost(bench):
    result = vehicles.CHAPTER.compute(bench, IDEAL)
    mape = {telling: result.figures[f"mape.{FLEET_SET}.{key_of(telling, LIKE)}"] for telling in Telling}
    assert mape[Telling.WRONG] > mape[Telling.MATCHED]
    assert mape[Telling.IDENTIFIED] < mape[Telling.WRONG]
    assert result.figures["headline.best.unseen_fleet_mape"] == mape[Telling.IDENTIFIED]
    assert result.figures["headline.paper_config.unseen_fleet_mape"] > mape[Telling.MATCHED]
    exact = f"mape.{FLEET_SET}.{key_of(Telling.MATCHED, EXACT)}"
    assert result.figures[exact] == mape[Telling.MATCHED]
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)
    again = vehicles.CHAPTER.compute(bench, IDEAL)
    assert again.figures == result.figures
    assert len(bench.worked) == 2


def test_no_one_is_judged_by_what_learned_from_his_group(bench, monkeypatch):
    seen = []

    def learn(features, label_mu):
        seen.append(set(label_mu.tolist()))
        return lambda rows: np.full(len(rows), 0.5)

    monkeypatch.setattr(vehicles, "BASELINES", {})
    monkeypatch.setattr(vehicles, "BEST_RECIPE", replace(SMALL_BEST, learn=_Spy(learn)))
    judged = vehicles.estimated(bench, IDEAL, FLEET_SET)
    groups = 6
    assert len(seen) == groups * len(Telling)
    whole = set(judged.label_mu.tolist())
    left_out = [whole - labels for labels in seen]
    assert all(80 < len(out) <= 121 for out in left_out)


class _Spy:
    def __init__(self, learn):
        self.learn = learn

    def __call__(self, features, label_mu):
        return self.learn(features, label_mu)


def test_the_headline_never_goes_by_a_memory_that_harms():
    label = np.full(4, 0.5)

    def judged(identified, wrong):
        mu = {key_of(Telling.IDENTIFIED, LIKE): label * identified, key_of(Telling.WRONG, LIKE): label * wrong}
        return Estimated(label, label, mu)

    assert vehicles.headline_telling(judged(1.05, 1.2)) is Telling.IDENTIFIED
    assert vehicles.headline_telling(judged(1.3, 1.2)) is Telling.WRONG


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        (BETTER, "wins"),
        (BETTER | {Telling.WRONG: 0.2, Telling.IDENTIFIED: 0.4}, "wins nothing of that back"),
        (BETTER | {Telling.WRONG: 0.2, Telling.MATCHED: 0.4}, "cost nothing"),
    ],
)
def test_the_verdict_follows_the_figures(bench, noise, words):
    bench.data_sets = {FLEET_SET: lives(noise=noise), PAPER_CAR_SET: lives(noise=noise)}
    result = vehicles.CHAPTER.compute(bench, IDEAL)
    text = vehicles.CHAPTER.verdict({IDEAL: result}).text
    assert words in text
    assert ("learning does not help" in text) == (noise[Telling.IDENTIFIED] > noise[Telling.WRONG])
