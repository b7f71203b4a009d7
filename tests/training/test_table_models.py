"""Models of feature tables, judged by strangers: what goes into the default bundle, without a simulator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roadgrip.bundle import BundleManifest, Conformal
from roadgrip.features import GRIP_TABLE, PAPER_TABLE, FeatureTable
from rsu_app.adapters.inference import load_bundle
from rsu_app.domain.judgement import judgement
from tests.training.many_roads import runs_of_many_roads
from tests.training.runs import made_up_runs, shuffled
from training.bundling import write_models
from training.dataset import DatasetError, joined
from training.designs import PAPER_ROADS
from training.fit_parameters import FitParameters
from training.table_figures import figures_of, fresh_figures, holds, parts_of, strange_figures
from training.table_models import (
    COVERAGE_FRAC,
    FOLDS_COUNT,
    LEAST_DOUBTFUL_RATIO,
    LITTLE_USE_RATIO,
    Answers,
    GrownModel,
    TablePlan,
    best_plan,
    calibrated,
    grown_model,
    learned_drives,
    ordinary_driving,
    paper_plan,
    steps_count,
)

pytestmark = pytest.mark.xdist_group("table-models")  # its fixtures take most of the time

RUNS = runs_of_many_roads(1200)
DRIVES = learned_drives(RUNS, seed=1)
FRESH = runs_of_many_roads(400, seed=3, first_road_number=50)
FRESH = FRESH.rows(np.flatnonzero(FRESH.usable))


def few_trees(plan: TablePlan) -> TablePlan:
    return replace(plan, parameters=replace(plan.parameters, trees_count=25, learning_rate_ratio=0.2))


@pytest.fixture(scope="module")
def models() -> list[GrownModel]:
    return [grown_model(DRIVES, few_trees(plan)) for plan in (best_plan(seed=1), paper_plan(FitParameters()))]


@pytest.fixture(scope="module")
def bundle(models: list[GrownModel], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, BundleManifest]:
    folder = tmp_path_factory.mktemp("bundle")
    ordinary = ordinary_driving(DRIVES, seed=1)
    made = [model.for_bundle(DRIVES.runs, unseen=FRESH, ordinary=ordinary) for model in models]
    figures = figures_of(models[0], DRIVES)
    return folder, write_models(made, folder, name="test", metrics=figures, provenance={}, rng=np.random.default_rng(1))


def test_all_drives_of_a_random_road_are_judged_together_and_those_of_known_roads_are_dealt_out() -> None:
    sections = np.array(DRIVES.runs.section_id)
    for name in set(sections.tolist()):
        folds = set(DRIVES.fold[sections == name].tolist())
        assert len(folds) == (1 if name.startswith("random") else FOLDS_COUNT)


def test_the_order_of_the_rows_changes_nothing() -> None:
    again = learned_drives(shuffled(RUNS, seed=4), seed=1)
    assert again.runs.run_key == DRIVES.runs.run_key
    assert (again.fold == DRIVES.fold).all()


def test_a_drive_under_both_grades_of_sensors_is_judged_in_one_fold() -> None:
    both = learned_drives(joined([RUNS, RUNS]), seed=1)
    fold_of = dict(zip(DRIVES.runs.run_key, DRIVES.fold.tolist(), strict=True))
    assert both.fold.tolist() == [fold_of[key] for key in both.runs.run_key]


def test_a_few_roads_say_nothing_about_the_next() -> None:
    with pytest.raises(DatasetError, match="3 random roads say nothing"):
        learned_drives(made_up_runs(300), seed=1)


def test_every_drive_is_judged_by_strangers_alone(models: list[GrownModel]) -> None:
    # Frictions of one fold that are nonsense change what its strangers learned nowhere but in the other folds.
    own = DRIVES.fold == 2
    labels = DRIVES.runs.labels
    nonsense = np.where(own, labels["label_mu"][::-1], labels["label_mu"])
    other = replace(DRIVES, runs=replace(DRIVES.runs, labels={**labels, "label_mu": nonsense}))
    mu = grown_model(other, models[1].plan).strangers.mu
    assert mu[own] == pytest.approx(models[1].strangers.mu[own], abs=1e-9)
    assert np.abs(mu[~own] - models[1].strangers.mu[~own]).max() > 0.01


def test_steps_are_told_up_to_the_last() -> None:
    told: list[int] = []
    grown_model(DRIVES, few_trees(paper_plan(FitParameters())), on_step=told.append)
    assert told == list(range(1, steps_count() + 1))


def test_the_bundle_loads_in_the_unit_and_serves_both_tables(bundle: tuple[Path, BundleManifest]) -> None:
    loaded = load_bundle(bundle[0])
    assert loaded.manifest.table_digests == (GRIP_TABLE.digest, PAPER_TABLE.digest)
    assert all(model.conformal and model.ordinary and model.error_model_file for model in loaded.manifest.models)


def test_what_was_exported_answers_as_the_trees_do(
    bundle: tuple[Path, BundleManifest], models: list[GrownModel]
) -> None:
    metrics = bundle[1].metrics
    differences = [value for name, value in metrics.items() if name.startswith("onnx_difference")]
    assert len(differences) == 2 * len(models)
    assert max(differences) < 1e-5


def test_a_doubtful_passage_only_says_at_least(bundle: tuple[Path, BundleManifest]) -> None:
    for model in bundle[1].models:
        assert model.conformal is not None
        row = np.array(model.golden.rows[0])
        limit = model.conformal.doubtful_above_ratio
        sure, doubtful = (
            judgement(row, model, mu=0.4, expected_error_ratio=error) for error in (0.5 * limit, 2.0 * limit)
        )
        assert (sure.at_least, doubtful.at_least) == (False, True)
        assert doubtful.mu_low is not None
        assert sure.mu_low is not None
        assert doubtful.mu_low < sure.mu_low < 0.4


def test_intervals_hold_the_truth_about_as_often_as_they_say(models: list[GrownModel]) -> None:
    for model in models:
        figures = figures_of(model, DRIVES)
        assert figures[f"coverage_frac.unseen_roads.{model.plan.version}"] == pytest.approx(COVERAGE_FRAC, abs=0.05)
        fresh = fresh_figures(model, FRESH, part="fresh")
        assert fresh[f"coverage_frac.fresh.{model.plan.version}"] > COVERAGE_FRAC - 0.1


def answers_for(use_ratio: np.ndarray, *, scale: float) -> Answers:
    # The less of the grip was used, the more error there is, and the model knows.
    expected = scale / np.maximum(use_ratio, 0.1)
    sign = np.where(np.arange(len(use_ratio)) % 2, 1.0, -1.0)
    return Answers(DRIVES.label_mu * np.exp(0.8 * sign * expected), expected)


@pytest.mark.parametrize(("scale", "says"), [(0.05, True), (0.002, False)])
def test_who_used_little_says_at_least_unless_it_knows_all_the_same(scale: float, says: bool) -> None:
    use_ratio = np.random.default_rng(1).uniform(0.15, 1.0, len(DRIVES.runs))
    labels = {**DRIVES.runs.labels, "peak_utilisation_ratio": use_ratio}
    answers = answers_for(use_ratio, scale=scale)
    meaning = calibrated(answers, labels, rows=~DRIVES.known)
    said = answers.expected_error_ratio > meaning.doubtful_above_ratio
    assert meaning.doubtful_above_ratio >= LEAST_DOUBTFUL_RATIO
    assert said[use_ratio < 0.9 * LITTLE_USE_RATIO].all() == says
    assert not said[use_ratio > 1.1 * LITTLE_USE_RATIO].any()


def test_who_does_not_tell_how_much_grip_it_used_has_no_say_in_what_is_doubtful() -> None:
    use_ratio = np.random.default_rng(1).uniform(0.15, 1.0, len(DRIVES.runs))
    answers = answers_for(use_ratio, scale=0.05)
    told = calibrated(answers, {**DRIVES.runs.labels, "peak_utilisation_ratio": use_ratio}, rows=~DRIVES.known)
    half = np.where(np.arange(len(use_ratio)) % 2, use_ratio, np.nan)
    some = calibrated(answers, {**DRIVES.runs.labels, "peak_utilisation_ratio": half}, rows=~DRIVES.known)
    assert some.doubtful_above_ratio == pytest.approx(told.doubtful_above_ratio, rel=0.1)
    unknown = {**DRIVES.runs.labels, "peak_utilisation_ratio": np.full(len(use_ratio), np.nan)}
    with pytest.raises(DatasetError, match="how much of the grip it used"):
        calibrated(answers, unknown, rows=~DRIVES.known)
    given = calibrated(answers, unknown, rows=~DRIVES.known, doubtful_above_ratio=0.3)
    assert given.doubtful_above_ratio == 0.3


def test_what_weighs_nothing_teaches_nothing() -> None:
    # Every third drive says nonsense: with next to no weight it does not matter.
    nonsense = np.arange(len(RUNS)) % 3 == 1
    labels = {**RUNS.labels, "label_mu": np.where(nonsense, 0.9, RUNS.labels["label_mu"])}
    wrong = replace(RUNS, labels=labels)
    plan = few_trees(paper_plan(FitParameters()))
    weight = np.where(nonsense, 1e-6, 1.0)
    error = []
    for drives in (learned_drives(wrong, seed=1), learned_drives(wrong, seed=1, weight_ratio=weight)):
        right = drives.label_mu < 0.9
        error.append(float(np.abs(grown_model(drives, plan).strangers.mu / drives.label_mu - 1.0)[right].mean()))
    assert error[1] < 0.5 * error[0]


def test_without_a_known_road_the_one_that_was_driven_most_stands_for_it() -> None:
    random = RUNS.rows(np.flatnonzero(~np.isin(RUNS.section_id, PAPER_ROADS)))
    drives = learned_drives(random, seed=1)
    assert not drives.known.any()
    ordinary = ordinary_driving(drives, seed=1)
    found = strange_figures(ordinary, drives.runs, {"all": drives.fold >= 0}, among=drives.fold >= 0)
    assert found["strange_frac.all"] < 0.1


def test_a_bound_that_lies_below_the_truth_holds_however_far() -> None:
    answers = Answers(np.array([0.1, 0.1, 0.9]), np.array([0.01, 0.3, 0.3]))
    meaning = Conformal(coverage_frac=0.9, quantile=2.0, doubtful_above_ratio=0.1)
    assert holds(answers, np.full(3, 0.4), meaning).tolist() == [False, True, False]


def test_parts_are_parts_of_the_whole(models: list[GrownModel]) -> None:
    figures, version = figures_of(models[0], DRIVES), models[0].plan.version
    count = {name.removesuffix(f".{version}"): v for name, v in figures.items() if name.startswith("rows_count")}
    parts = parts_of(DRIVES.runs, known=DRIVES.known)
    assert count["rows_count.known_roads"] + count["rows_count.unseen_roads"] == len(DRIVES.runs)
    for one, other in (("usual_drivers", "any_speed"), ("high_use", "low_use")):
        assert (parts[f"unseen_roads.{one}"] ^ parts[f"unseen_roads.{other}"] == parts["unseen_roads"]).all()
    bands = [rows for name, rows in parts.items() if ".friction_" in name]
    assert (np.sum(bands, axis=0) == parts["unseen_roads"]).all()


@pytest.mark.parametrize("table", [PAPER_TABLE, GRIP_TABLE])
def test_few_drives_on_known_roads_are_called_strange(table: FeatureTable) -> None:
    ordinary = ordinary_driving(DRIVES, seed=1, table=table, without_fold=0)
    assert set(ordinary.driving.columns) <= set(table.names)
    found = strange_figures(ordinary, DRIVES.runs, {"known": DRIVES.known}, among=DRIVES.fold == 0)
    assert found["strange_frac.known"] < 0.1
