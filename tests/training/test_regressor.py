from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xgboost

from roadgrip.errors import BundleError
from roadgrip.units import BoolArray, FloatArray
from tests.training.runs import made_up_runs, shuffled
from training.accuracy import mape_ratio
from training.dataset import DatasetError, Runs
from training.export import check_parity, onnx_estimate_mu, parity_rows, to_onnx
from training.fit_parameters import FitParameters, Target
from training.regressor import (
    base_column_of,
    certainty_ratio,
    estimate_mu,
    fit,
    grow_trees,
    judge,
    mape_ratio_on_unseen_roads,
    split_rows,
    target_of,
)

QUICK = FitParameters(trees_count=60)


def test_trees_learn_a_law_well_below_the_spread_of_the_labels() -> None:
    runs = made_up_runs(2000)
    fitted = fit(runs, QUICK)
    label_mu = runs.labels["label_mu"][fitted.test_rows]
    guess = mape_ratio(label_mu, np.full_like(label_mu, label_mu.mean()))
    assert fitted.metrics["mape_ratio"] < 0.4 * guess


def test_rows_for_judging_are_not_learned_from_and_failed_runs_are_in_neither() -> None:
    runs = made_up_runs(500)
    fitted = fit(runs, QUICK)
    train, test = set(fitted.train_rows.tolist()), set(fitted.test_rows.tolist())
    assert not train & test
    assert train | test == set(np.flatnonzero(runs.usable).tolist())


def test_another_seed_judges_on_other_rows() -> None:
    runs = made_up_runs(500)
    (_, one), (_, other) = split_rows(runs, seed=1), split_rows(runs, seed=2)
    assert set(one.tolist()) != set(other.tolist())


def test_the_order_of_the_rows_does_not_change_the_trees() -> None:
    runs = made_up_runs(600)
    rows = np.nan_to_num(runs.features)
    one, other = fit(runs, QUICK), fit(shuffled(runs, seed=5), QUICK)
    assert np.array_equal(estimate_mu(one.booster, rows), estimate_mu(other.booster, rows))


def test_too_few_runs_are_refused() -> None:
    with pytest.raises(DatasetError, match="usable runs"):
        fit(made_up_runs(30), QUICK)


def test_figures_of_merit_are_also_told_per_section() -> None:
    truth = np.full(40, 0.4)
    estimate = np.where(np.arange(40) % 2 == 0, 0.4, 0.44)
    metrics = judge(truth, estimate, section_id=["even" if i % 2 == 0 else "odd" for i in range(40)])
    assert metrics["mape_ratio.even"] == 0.0
    assert metrics["mape_ratio.odd"] == pytest.approx(0.1)


def test_the_export_answers_as_the_trees_do_on_thousands_of_rows_edges_included() -> None:
    runs = made_up_runs(1500)
    fitted = fit(runs, QUICK)
    rows = parity_rows(runs.features[fitted.train_rows], rng=np.random.default_rng(1))
    assert len(rows) >= 2000
    assert check_parity(fitted.booster, to_onnx(fitted.booster), rows) < 1e-5


def test_an_export_of_other_trees_does_not_pass_the_gate() -> None:
    runs = made_up_runs(1500)
    fitted, other = fit(runs, QUICK), fit(runs, FitParameters(trees_count=61))
    rows = parity_rows(runs.features[fitted.train_rows], rng=np.random.default_rng(1))
    with pytest.raises(BundleError, match="differs from the trained one"):
        check_parity(fitted.booster, to_onnx(other.booster), rows)


def test_an_export_that_answers_with_no_number_does_not_pass_the_gate(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = made_up_runs(1500)
    fitted = fit(runs, QUICK)
    rows = parity_rows(runs.features[fitted.train_rows], rng=np.random.default_rng(1))
    monkeypatch.setattr("training.export.onnx_estimate_mu", lambda _model, rows: np.full(len(rows), np.nan))
    with pytest.raises(BundleError, match="differs from the trained one"):
        check_parity(fitted.booster, b"", rows)


def test_parity_on_a_handful_of_rows_is_refused() -> None:
    runs = made_up_runs(500)
    fitted = fit(runs, QUICK)
    with pytest.raises(BundleError, match="proves nothing"):
        check_parity(fitted.booster, to_onnx(fitted.booster), runs.features[:5])


def test_the_export_gives_one_friction_per_row() -> None:
    runs = made_up_runs(500)
    model = to_onnx(fit(runs, QUICK).booster)
    assert onnx_estimate_mu(model, np.zeros((7, runs.features.shape[1]))).shape == (7,)


def on_many_roads(runs: Runs, *, roads_count: int) -> Runs:
    return replace(runs, section_id=tuple(f"road-{i % roads_count:02d}" for i in range(len(runs))))


def test_a_law_that_holds_everywhere_is_found_on_unseen_roads_too() -> None:
    runs = on_many_roads(made_up_runs(1500), roads_count=15)
    fitted = fit(runs, QUICK)
    assert mape_ratio_on_unseen_roads(runs, QUICK) < 1.3 * fitted.metrics["mape_ratio"]


@pytest.mark.long
def test_a_law_that_every_road_has_for_itself_is_not() -> None:
    runs = on_many_roads(made_up_runs(1500), roads_count=15)
    road = np.array([int(name[-2:]) for name in runs.section_id])
    noise = np.random.default_rng(0).normal(size=runs.features[:, 1:].shape)
    features = np.column_stack([road.astype(float), noise])
    label_mu = 0.2 + 0.5 * np.random.default_rng(1).permutation(15)[road] / 15
    own = replace(runs, features=features, labels={**runs.labels, "label_mu": label_mu})
    assert fit(own, QUICK).metrics["mape_ratio"] < 0.15
    assert mape_ratio_on_unseen_roads(own, QUICK) > 0.3


def test_a_few_roads_say_nothing_about_the_next() -> None:
    with pytest.raises(DatasetError, match="roads say nothing"):
        mape_ratio_on_unseen_roads(made_up_runs(300), QUICK)


def test_the_same_runs_give_the_same_model_byte_for_byte() -> None:
    runs = made_up_runs(400)
    assert to_onnx(fit(runs, QUICK).booster) == to_onnx(fit(shuffled(runs, seed=1), QUICK).booster)


def test_trees_of_the_logarithm_answer_in_friction_and_say_so_in_their_file(tmp_path: Path) -> None:
    runs = made_up_runs(1000)
    features, label_mu = runs.features[runs.usable], runs.labels["label_mu"][runs.usable]
    booster = grow_trees(features, label_mu, replace(QUICK, target=Target.LOG_MU))
    assert mape_ratio(label_mu, estimate_mu(booster, features)) < 0.1
    booster.save_model(tmp_path / "trees.ubj")
    read = xgboost.Booster(model_file=tmp_path / "trees.ubj")
    assert target_of(read) is Target.LOG_MU
    assert np.array_equal(estimate_mu(read, features), estimate_mu(booster, features))


def test_trees_that_mend_a_first_guess_start_from_it_and_say_so_in_their_file(tmp_path: Path) -> None:
    runs = made_up_runs(600)
    features, label_mu = runs.features[runs.usable].copy(), runs.labels["label_mu"][runs.usable]
    features[:, 3] = 1.25 * label_mu
    mending = replace(QUICK, trees_count=1, target=Target.LOG_MU, base_column=3)
    booster = grow_trees(features, label_mu, mending)
    assert mape_ratio(label_mu, estimate_mu(booster, features)) < 0.01
    booster.save_model(tmp_path / "trees.ubj")
    read = xgboost.Booster(model_file=tmp_path / "trees.ubj")
    assert base_column_of(read) == 3
    assert np.array_equal(estimate_mu(read, features), estimate_mu(booster, features))


def test_only_trees_of_the_logarithm_mend_a_first_guess() -> None:
    with pytest.raises(ValueError, match="only a logarithm"):
        grow_trees(np.ones((9, 2)), np.ones(9), replace(QUICK, base_column=1))


def test_rows_of_no_weight_are_not_learned_from() -> None:
    runs = made_up_runs(600)
    features, label_mu = runs.features[runs.usable], runs.labels["label_mu"][runs.usable]
    believed = np.arange(len(label_mu)) % 2 == 0
    lied_mu = np.where(believed, label_mu, 2.0)
    booster = grow_trees(features, lied_mu, QUICK, weight_ratio=believed.astype(float))
    assert estimate_mu(booster, features).max() < 1.0


def test_threads_do_not_change_the_trees() -> None:
    runs = made_up_runs(600)
    features, label_mu = runs.features[runs.usable], runs.labels["label_mu"][runs.usable]
    one = grow_trees(features, label_mu, QUICK, threads_count=1)
    two = grow_trees(features, label_mu, QUICK, threads_count=2)
    assert np.array_equal(estimate_mu(one, features), estimate_mu(two, features))


THOROUGH = FitParameters(trees_count=150, depth_count=4, learning_rate_ratio=0.15, column_share_frac=1.0)


def half_in_noise(count: int) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return rows, their frictions, and which half of them, told by the second feature, says nothing of its own."""
    runs = made_up_runs(count)
    features, label_mu = runs.features[runs.usable], runs.labels["label_mu"][runs.usable]
    noisy: BoolArray = np.arange(len(features)) % 2 == 0
    features[:, 1] = noisy
    label_mu[noisy] = np.random.default_rng(2).permutation(label_mu[noisy])
    return features, label_mu, noisy


@pytest.mark.parametrize("target", Target)
def test_rows_that_tell_little_weigh_little(target: Target) -> None:
    features, label_mu, noisy = half_in_noise(1500)
    weight = certainty_ratio(features, label_mu, replace(THOROUGH, target=target, certainty_power_ratio=1.0))
    assert weight.mean() == pytest.approx(1.0)
    assert weight[~noisy].mean() > 1.5 * weight[noisy].mean()


@pytest.mark.long
def test_weights_by_certainty_make_what_can_be_known_better_known() -> None:
    features, label_mu, _ = half_in_noise(3000)
    fresh = made_up_runs(1000, seed=5)
    rows = fresh.features[fresh.usable]
    rows[:, 1] = 0.0

    def error(parameters: FitParameters) -> float:
        trees = grow_trees(features, label_mu, parameters)
        return mape_ratio(fresh.labels["label_mu"][fresh.usable], estimate_mu(trees, rows))

    assert error(replace(THOROUGH, certainty_power_ratio=2.0)) < error(THOROUGH)


def test_rows_weigh_the_same_on_any_number_of_threads() -> None:
    features, label_mu, _ = half_in_noise(400)
    parameters = replace(THOROUGH, certainty_power_ratio=1.0)
    one, two = (certainty_ratio(features, label_mu, parameters, threads_count=count) for count in (1, 2))
    assert np.allclose(one, two, rtol=1e-6)
