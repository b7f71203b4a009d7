"""Chapters on intervals, wear, drivers, amplitudes, manoeuvres and published figures: their maths, and their sums."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.study.desk import Desk
from tests.training.study.paper.drives import drives
from training.study.batches import CellErrors
from training.study.chapter import Chapter, Claim
from training.study.folds import rows_by_name
from training.study.paper import drivers, interval_accuracy, manoeuvres, published, sensitivity, wear
from training.study.paper_features import PAPER_FEATURES
from vehicle_client.simulator.plan import SensorGrade

ROADS = ("long", "sharp", "winding")
IDEAL = SensorGrade.IDEAL


@pytest.fixture(scope="module")
def desk() -> Desk:
    paper = drives(ROADS, per_cell_count=24)
    random_roads = tuple(f"random-{i}" for i in range(24))
    return Desk(
        data_sets={
            "paper": paper,
            "paper-reacting": drives(ROADS, per_cell_count=8),
            "paper-fleet": drives(ROADS, per_cell_count=12, seed=5, design="varied-vehicles"),
            "manoeuvres": drives(("slalom", "sine"), per_cell_count=10, seed=6, design="manoeuvres", wild_ratio=30.0),
            "random-roads": drives(random_roads, per_cell_count=4, seed=7, design="random-roads"),
            **{name: drives(ROADS, per_cell_count=12, seed=8) for name in sensitivity.SETTINGS.values()},
        }
    )


@pytest.fixture(autouse=True)
def _no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search for features has tests of its own and takes its time."""
    for module in (interval_accuracy, manoeuvres):
        monkeypatch.setattr(module, "selected_features", lambda _bench, _grade: PAPER_FEATURES[:3])


@pytest.mark.parametrize(
    "chapter",
    [module.CHAPTER for module in (interval_accuracy, wear, drivers, sensitivity, manoeuvres, published)],
    ids=lambda chapter: chapter.name,
)
def test_a_chapter_computes_what_it_needs_and_judges_it(desk: Desk, chapter: Chapter):
    assert set(chapter.needed(SensorGrade.AUTOMOTIVE)) <= desk.data_sets.keys()
    result = chapter.compute(desk, IDEAL)
    assert all(np.isfinite(value) for value in result.figures.values())
    assert result.sizes["seed"] == desk.seed
    for table in result.tables:
        assert {len(row) for row in table.rows} == {len(table.columns)}
    verdict = chapter.verdict(
        {IDEAL: result, SensorGrade.AUTOMOTIVE: result} if chapter.name != "sensitivity" else {IDEAL: result}
    )
    assert verdict.claim in Claim
    assert "nan" not in verdict.text


def test_the_figures_others_read_are_there(desk: Desk):
    interval = interval_accuracy.compute(desk, IDEAL).figures
    assert interval["headline.paper_config.interval50_worst_known"] == interval["worst_p95.78 features.50"]
    flags = manoeuvres.compute(desk, IDEAL).figures
    for config in ("paper_config", "best"):
        for which in ("extreme", "normal", "unseen"):
            assert 0.0 <= flags[f"headline.{config}.{which}_flagged_frac"] <= 1.0


def test_wild_drives_are_flagged_and_known_roads_are_not(desk: Desk):
    figures = manoeuvres.compute(desk, IDEAL).figures
    assert figures["headline.best.extreme_flagged_frac"] == 1.0
    assert figures["headline.best.normal_flagged_frac"] < 0.1


def test_the_worst_road_is_found_at_every_friction():
    def errors(road: str, mu: float, p95: float) -> CellErrors:
        return CellErrors(road, mu, 9, 50, 9, 1.0, 0.0, p95, p95, p95)

    worst = interval_accuracy.worst_by_friction(
        (errors("a", 0.5, 0.1), errors("b", 0.5, 0.3), errors("a", 0.2, 0.2), errors("b", 0.2, 0.1))
    )
    assert {mu: one.road for mu, one in worst.items()} == {0.2: "a", 0.5: "b"}
    assert list(worst) == [0.2, 0.5]


@pytest.mark.parametrize(
    ("name", "median_ratio"),
    [
        (wear.EVEN, 0.9),
        (wear.NEW, 0.99),
        (wear.WORN, 0.81),
        (wear.MOSTLY_NEW, 0.8 + 0.2 * np.sqrt(0.5)),
        (wear.MOSTLY_WORN, 1.0 - 0.2 * np.sqrt(0.5)),
    ],
)
def test_drawn_tyres_have_the_wear_that_is_supposed(name: str, median_ratio: float):
    ratios = np.random.default_rng(1).uniform(0.8, 1.0, 20_000)
    rows = wear.redrawn_rows(
        np.random.default_rng(2), np.arange(len(ratios)), ratios, wear.SUPPOSED[name], count=20_000
    )
    assert np.median(ratios[rows]) == pytest.approx(median_ratio, abs=0.003)


def test_a_cell_without_such_tyres_gives_none():
    rows = wear.redrawn_rows(
        np.random.default_rng(2), np.arange(3), np.full(3, 0.85), wear.SUPPOSED[wear.NEW], count=10
    )
    assert len(rows) == 0


def test_new_tyres_place_the_interval_too_high_and_worn_ones_too_low(desk: Desk):
    figures = wear.compute(desk, IDEAL).figures
    assert figures[f"bias.{wear.FLOOR}.{wear.NEW}"] == pytest.approx(0.1, abs=0.02)
    assert figures[f"bias.{wear.FLOOR}.{wear.WORN}"] == pytest.approx(-0.1, abs=0.02)
    soft = figures[f"bias.{wear.FLOOR}.{wear.SOFT}"] - figures[f"bias.{wear.FLOOR}.{wear.EVEN}"]
    assert soft == pytest.approx(wear.PRESSURE_RATIO, abs=0.01)


def test_a_regressor_learns_from_nobody_who_is_judged():
    home, judged = drives(ROADS, per_cell_count=9), drives(ROADS, per_cell_count=4)
    learned = drivers.strangers(home, judged)
    assert not {home.run_key[row] for row in learned} & set(judged.run_key)
    assert len(learned) == sum(home.usable[i] and home.run_key[i] not in judged.run_key for i in range(len(home)))


def test_errors_name_the_worst_scenario():
    runs = drives(ROADS, per_cell_count=4)
    rows = rows_by_name(runs)
    truth = runs.labels["label_mu"][rows]
    off = np.where(np.array(runs.scenario)[rows] == "sharp", 1.2, 1.1)
    error = drivers.error_of(runs, rows, off * truth)
    assert error.worst_scenario == "sharp"
    assert error.worst_mape_ratio == pytest.approx(0.2)
    assert error.mape_ratio == pytest.approx(float(np.mean(off - 1.0)))


def test_the_first_runs_of_every_cell_are_taken_by_attempt():
    runs = drives(ROADS, per_cell_count=9)
    shuffled = runs.rows(np.random.default_rng(3).permutation(len(runs)))
    for table in (runs, shuffled):
        rows = sensitivity.first_rows(table, kept_count=4)
        kept = {table.run_key[row] for row in rows}
        assert len(kept) == len(rows) == 4 * 9
        for row in np.flatnonzero(table.usable):
            cell, number = table.run_key[row].rsplit("/", 1)
            if table.run_key[row] not in kept:
                assert all(key.rsplit("/", 1)[1] < number for key in kept if key.startswith(cell))


def test_the_next_runs_of_every_cell_are_others():
    runs = drives(ROADS, per_cell_count=9)
    first, following = (sensitivity.first_rows(runs, kept_count=4, skipped_count=count) for count in (0, 4))
    assert len(following) == 4 * 9
    assert not set(first.tolist()) & set(following.tolist())


def errors(count: int, *, seed: int, prefix: str = "") -> dict[str, float]:
    values = np.random.default_rng(seed).exponential(0.03, count)
    return {f"{prefix}{i:04d}": float(value) for i, value in enumerate(values)}


def test_a_share_more_error_on_every_drive_is_beyond_chance_however_the_drives_differ():
    usual = errors(100, seed=1)
    found = sensitivity.change_between(
        np.random.default_rng(2), usual, {name: 1.1 * error for name, error in usual.items()}
    )
    assert (found.ratio, found.low_ratio, found.high_ratio) == pytest.approx((0.1, 0.1, 0.1))
    assert found.both_count == 100


def test_the_same_difference_between_other_drives_may_be_chance():
    usual, others = errors(100, seed=1), errors(100, seed=1, prefix="other-")
    more = {name: 1.1 * error for name, error in others.items()}
    found = sensitivity.change_between(np.random.default_rng(2), usual, more)
    assert found.ratio == pytest.approx(0.1)
    assert found.low_ratio < 0.0 < found.high_ratio
    assert found.both_count == 0


def test_drives_that_differ_by_chance_alone_seldom_seem_to_differ(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sensitivity, "RESAMPLES_COUNT", 300)
    seeming = 0
    for number in range(60):
        usual, other = errors(150, seed=number), errors(150, seed=1000 + number)
        found = sensitivity.change_between(np.random.default_rng(number), usual, other)
        seeming += not found.low_ratio <= 0.0 <= found.high_ratio
    assert seeming <= 10


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.05, 0.15, "The strongest of those beyond chance with automotive sensors: sensor errors doubled."),
        (-0.05, 0.15, "none of them changes the MAPE beyond chance"),
    ],
)
def test_the_verdict_tells_differences_from_chance(desk: Desk, low: float, high: float, words: str):
    result = sensitivity.compute(desk, SensorGrade.AUTOMOTIVE)
    nothing = {f"change_{end}.{name}": 0.0 for name in sensitivity.SETTINGS for end in ("low", "high")}
    ends = {"change_low.sensor errors doubled": low, "change_high.sensor errors doubled": high}
    figures = {**result.figures, **nothing, **ends}
    told = sensitivity.verdict({SensorGrade.AUTOMOTIVE: replace(result, figures=figures)}).text
    assert words in told
    assert "roughness halved: no difference beyond chance" in told


def test_exact_sensors_are_not_driven_twice_as_exact(desk: Desk):
    without = {name: runs for name, runs in desk.data_sets.items() if not name.startswith("sensors")}
    ideal = sensitivity.compute(replace(desk, data_sets=without), IDEAL)
    assert not [name for name in ideal.figures if "sensor errors" in name]
    automotive = sensitivity.compute(desk, SensorGrade.AUTOMOTIVE)
    assert "change.sensor errors doubled" in automotive.figures
    assert sensitivity.verdict({SensorGrade.AUTOMOTIVE: automotive}).text.count("automotive") >= 2


def test_a_drive_is_as_wrong_as_its_passages():
    truth = np.array([0.3, 0.5, 0.6])
    rms = published.drive_rms_ratio(np.random.default_rng(1), truth, truth + 0.05, drives_count=50, passages_count=4)
    assert rms.shape == (50,)
    assert ((rms >= 0.05 / 0.6 - 1e-12) & (rms <= 0.05 / 0.3 + 1e-12)).all()
