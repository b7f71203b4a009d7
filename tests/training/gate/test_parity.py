"""Trees against their export: ten thousand rows, gaps and edges among them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE
from tests.training.gate.bouts import drives, thresholds
from training.bundling import TableModel, write_models
from training.export import to_onnx
from training.fit_parameters import FitParameters, Target
from training.gate.contender import read_contender
from training.gate.parity import difference_mu, onnx_parity, rows_to_compare
from training.regressor import grow_trees

LIMITS = replace(thresholds().parity, required=True)
NAMES = ("grip_all_best_mu", "speed_mean_mps", "sideslip_max_rad")
FIT = FitParameters(trees_count=8, depth_count=3, target=Target.LOG_MU, base_column=0)


@pytest.fixture(scope="module")
def runs():
    return drives("unseen_roads", runs_count=10)


@pytest.fixture(scope="module")
def trees(runs):
    """Trees of three columns that mend the first of them."""
    return grown(runs, runs.labels["label_mu"])


def grown(runs, label_mu, *, names=NAMES):
    """Return trees whose file will say which columns they were grown on."""
    booster = grow_trees(runs.columns(names), label_mu, FIT, threads_count=1)
    booster.set_attr(column_names=json.dumps(names))
    return booster


@pytest.fixture
def bundle(tmp_path, runs, trees):
    """The folder of a bundle of these trees, without them."""
    model = TableModel(
        table=NEWEST_TABLE,
        friction=trees,
        train_rows=runs.features,
        train_label_mu=runs.labels["label_mu"],
        unseen_rows=runs.features,
        column_names=NAMES,
    )
    write_models([model], tmp_path / "bundle", name="a", metrics={}, provenance={}, rng=np.random.default_rng(1))
    (tmp_path / "bundle" / "trees").mkdir()
    return tmp_path / "bundle"


def asked(bundle, runs, **changes):
    rng = np.random.default_rng(2)
    (check,) = onnx_parity(read_contender(bundle), {"unseen_roads": runs}, replace(LIMITS, **changes), rng=rng).checks
    return check


def test_an_export_answers_as_its_trees_do_gaps_included(bundle, runs, trees):
    trees.save_model(bundle / "trees" / "friction-v2.json")
    check = asked(bundle, runs)
    assert check.passed, check.sentence
    assert check.figures["rows_count"] >= 10_000
    assert check.figures["rows_with_gaps_count"] >= 2_000


def test_an_export_of_columns_in_another_order_fails(bundle, runs, trees):
    trees = trees.copy()
    trees.set_attr(column_names=json.dumps([NAMES[0], NAMES[2], NAMES[1]]))
    trees.save_model(bundle / "trees" / "friction-v2.json")
    check = asked(bundle, runs)
    assert check.failed
    assert check.figures["difference_mu"] > 1e-3


def test_other_trees_fail(bundle, runs):
    other = grown(runs, 1.001 * runs.labels["label_mu"])
    other.save_model(bundle / "trees" / "friction-v2.json")
    assert asked(bundle, runs).failed
    assert asked(bundle, runs, tolerance_mu=0.1).passed


@pytest.mark.parametrize("found", ["no folder", "no file", "no trees", "other columns"])
def test_without_the_trees_nothing_is_proved(bundle, runs, found):
    if found == "no folder":
        (bundle / "trees").rmdir()
    elif found == "no trees":
        (bundle / "trees" / "friction-v2.json").write_text("{}")
    elif found == "other columns":
        narrow = grown(runs, runs.labels["label_mu"], names=NAMES[:2])
        narrow.set_attr(column_names=None)
        narrow.save_model(bundle / "trees" / "friction-v2.json")
    assert asked(bundle, runs).failed
    assert "not possible" in asked(bundle, runs).sentence
    assert not asked(bundle, runs, required=False).failed


def test_a_number_where_the_other_has_none_is_no_parity(runs, trees):
    # Without its base column in the graph an export still answers where the trees give nothing.
    whole = trees.copy()
    whole.set_attr(base_column=None)
    export = to_onnx(whole, column_names=NAMES)
    rows = runs.features[:4].copy()
    rows[0, NEWEST_TABLE.index("grip_all_best_mu")] = np.nan
    assert difference_mu(trees, export, rows, NEWEST_TABLE.columns(NAMES).tolist()) == np.inf


def test_rows_have_every_feature_missing_once_and_values_on_splits(runs, trees):
    columns = NEWEST_TABLE.columns(NAMES).tolist()
    rows = rows_to_compare(runs.features, trees, columns, count=3000, table=NEWEST_TABLE, rng=np.random.default_rng(3))
    gaps = np.isnan(rows)
    alone = gaps[gaps.sum(axis=1) == 1]
    assert alone.any(axis=0).all()
    assert gaps.all(axis=1).any()
    frame = trees.get_dump(dump_format="json")
    assert '"split_condition"' in frame[0]
    split = float(frame[0].split('"split_condition": ')[1].split(",")[0])
    near = np.abs(rows[:, columns] / np.float32(split) - 1.0)
    assert (near == 0.0).any()
    assert ((near > 0.0) & (near < 1e-6)).any()
