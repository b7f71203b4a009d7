"""A bundle of several models: a table each, the logarithm behind an exponential, an error beside the friction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from roadgrip.bundle import BundleManifest, Conformal
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError
from roadgrip.features import FEATURE_NAMES, NEWEST_TABLE, PAPER_TABLE, FeatureTable
from rsu_app.adapters.inference import load_bundle
from tests.training.runs import made_up_runs
from training.bundling import TableModel, write_models
from training.dataset import Runs
from training.export import PARITY_TOLERANCE_MU, check_parity, onnx_estimate_mu, parity_rows, to_onnx
from training.fit_parameters import FitParameters, Target
from training.regressor import estimate_mu, grow_trees

pytestmark = pytest.mark.xdist_group("table-models")  # its fixtures take most of the time

CONFORMAL = Conformal(coverage_frac=0.9, quantile=1.8, doubtful_above_ratio=0.3)
LOG = FitParameters(trees_count=30, target=Target.LOG_MU)
PLAIN = FitParameters(trees_count=30)
MENDING = replace(LOG, trees_count=90, base_column=FEATURE_NAMES.index("grip_all_best_mu"))


def usable(runs: Runs) -> Runs:
    return runs.rows(np.flatnonzero(runs.usable))


def grown(runs: Runs, parameters: FitParameters, *, names: tuple[str, ...] | None = None, label=None):
    features = runs.features if names is None else runs.columns(names)
    target = runs.labels["label_mu"] if label is None else label
    return grow_trees(features, target, parameters, threads_count=1)


def model_of(runs: Runs, parameters: FitParameters = LOG, *, with_error: bool = True) -> TableModel:
    friction = grown(runs, parameters)
    label_mu = runs.labels["label_mu"]
    error_ratio = np.abs(estimate_mu(friction, runs.features) / label_mu - 1.0) + 1e-3
    return TableModel(
        table=runs.table,
        friction=friction,
        train_rows=runs.features[:-100],
        train_label_mu=label_mu[:-100],
        unseen_rows=runs.features[-100:],
        error=grown(runs, LOG, label=error_ratio) if with_error else None,
        conformal=CONFORMAL if with_error else None,
    )


RUNS = usable(made_up_runs(1300))


def written(models: list[TableModel], folder: Path) -> BundleManifest:
    return write_models(
        models, folder, name="test", metrics={}, provenance={"command": "a test"}, rng=np.random.default_rng(3)
    )


def rows_for(runs: Runs) -> np.ndarray:
    return parity_rows(runs.features, rng=np.random.default_rng(1), table=runs.table)


@pytest.mark.parametrize("parameters", [LOG, PLAIN, MENDING], ids=["logarithm", "friction", "mended guess"])
def test_the_export_answers_in_friction_whatever_the_trees_add_up_to(parameters: FitParameters) -> None:
    trees = grown(RUNS, parameters)
    model = to_onnx(trees)
    assert check_parity(trees, model, rows_for(RUNS)) < PARITY_TOLERANCE_MU
    answers = onnx_estimate_mu(model, RUNS.features)
    assert np.abs(answers - RUNS.labels["label_mu"]).mean() < 0.05


def test_the_gate_sees_a_missing_exponential() -> None:
    trees = grown(RUNS, LOG)
    bare = grown(RUNS, LOG)
    bare.set_attr(target=None)
    with pytest.raises(BundleError, match="differs from the trained one"):
        check_parity(trees, to_onnx(bare), rows_for(RUNS))


@pytest.mark.parametrize("parameters", [LOG, PLAIN], ids=["logarithm", "friction"])
def test_trees_on_some_columns_are_asked_with_whole_rows(parameters: FitParameters) -> None:
    names = ("speed_mean_mps", "steer_mean_rad", "section_length_m")
    trees = grown(RUNS, parameters, names=names)
    model = to_onnx(trees, column_names=names)
    rows = rows_for(RUNS)
    assert check_parity(trees, model, rows, column_names=names) < PARITY_TOLERANCE_MU
    with pytest.raises(BundleError, match="differs from the trained one"):
        check_parity(trees, model, rows, column_names=names[::-1])
    with pytest.raises(BundleError, match=f"grown on 3 columns, {len(NEWEST_TABLE)} are named"):
        to_onnx(trees)


def test_parity_rows_reach_both_ends_of_every_feature_and_hold_no_gap() -> None:
    rows = rows_for(RUNS)
    assert np.isfinite(rows).all()
    for end in (NEWEST_TABLE.minimum, NEWEST_TABLE.maximum):
        # All of them at once, and each for itself beside what is ordinary.
        assert (rows == end).all(axis=1).any()
        assert ((rows == end).sum(axis=0) >= 2).all()


def test_a_unit_loads_a_model_for_each_table_with_its_expected_error(tmp_path: Path, wider_table: FeatureTable) -> None:
    wide = usable(made_up_runs(1300, seed=4, table=wider_table))
    narrow = wide.for_table(PAPER_TABLE)
    models = [model_of(wide), model_of(narrow)]
    manifest = written(models, tmp_path)
    assert manifest.table_digests == (wider_table.digest, PAPER_TABLE.digest)
    served = load_bundle(tmp_path)
    assert served.manifest == manifest
    for model, runs in zip(models, (wide, narrow), strict=True):
        inside = runs.features.astype(np.float32).astype(np.float64)
        answers = served.estimate(runs.table.digest, inside)
        assert model.error is not None
        assert answers.mu == pytest.approx(estimate_mu(model.friction, inside), abs=1e-5)
        assert answers.expected_error_ratio == pytest.approx(estimate_mu(model.error, inside), abs=1e-5)


def test_the_manifest_tells_how_far_each_export_is_from_its_trees(tmp_path: Path) -> None:
    manifest = written([model_of(RUNS)], tmp_path)
    version = f"v{RUNS.table.version}"
    for name in (f"onnx_difference_mu.{version}", f"onnx_difference_ratio.{version}"):
        assert 0.0 <= manifest.metrics[name] < PARITY_TOLERANCE_MU
    assert manifest_from_json((tmp_path / "manifest.json").read_text()) == manifest


def test_the_same_models_make_the_same_bundle(tmp_path: Path) -> None:
    one, other = (written([model_of(RUNS)], tmp_path / name) for name in ("one", "other"))
    assert one == other


@pytest.mark.parametrize("missing", ["error", "conformal"])
def test_an_expected_error_that_means_nothing_is_not_written(tmp_path: Path, missing: str) -> None:
    model = model_of(RUNS)
    model = replace(model, error=None) if missing == "error" else replace(model, conformal=None)
    with pytest.raises(BundleError, match="expected error needs"):
        written([model], tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


def test_rows_that_no_unit_would_ask_about_prove_nothing(tmp_path: Path) -> None:
    model = model_of(RUNS)
    impossible = model.unseen_rows.copy()
    impossible[:, 0] = 100.0
    with pytest.raises(BundleError, match="nothing can prove them"):
        written([replace(model, unseen_rows=impossible)], tmp_path)
    some = np.vstack([impossible, model.unseen_rows[:3]])
    assert len(written([replace(model, unseen_rows=some)], tmp_path).models[0].golden.rows) == 3


def operators_in(path: Path) -> set[str]:
    return {node.op_type for node in onnx.load(path).graph.node}


def test_a_unit_still_loads_a_bundle_whose_trees_are_in_their_former_form(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = model_of(RUNS, MENDING)
    compact = written([model], tmp_path / "compact")
    monkeypatch.setattr("training.export.with_compact_trees", lambda model: model)
    former = written([model], tmp_path / "former")
    assert "TreeEnsembleRegressor" in operators_in(tmp_path / "former" / former.models[0].model_file)
    assert "TreeEnsembleRegressor" not in operators_in(tmp_path / "compact" / compact.models[0].model_file)
    inside = RUNS.features.astype(np.float32).astype(np.float64)
    answers, same = (load_bundle(tmp_path / name).estimate(RUNS.table.digest, inside) for name in ("former", "compact"))
    assert np.array_equal(answers.mu, same.mu)
    assert answers.expected_error_ratio is not None
    assert same.expected_error_ratio is not None
    assert np.array_equal(answers.expected_error_ratio, same.expected_error_ratio)
