"""Trees in their small form answer as in the converters' form, to the bit; what has no small form is refused."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from roadgrip.errors import BundleError
from tests.training.former_trees import former_trees
from tests.training.runs import made_up_runs
from training.compact_trees import with_compact_trees
from training.export import onnx_estimate_mu
from training.fit_parameters import FitParameters, Target
from training.regressor import grow_trees

COLUMNS = 3


def rows_with_gaps(width: int, *, count: int = 2000) -> np.ndarray:
    rng = np.random.default_rng(7)
    rows = rng.normal(scale=3.0, size=(count, width))
    rows[rng.random(rows.shape) < 0.05] = np.nan
    return rows


def answers_of(model: onnx.ModelProto, rows: np.ndarray) -> np.ndarray:
    return onnx_estimate_mu(model.SerializeToString(), rows)


def operators_of(model: onnx.ModelProto) -> list[str]:
    return [node.op_type for node in model.graph.node]


@pytest.mark.parametrize("target", list(Target))
def test_grown_trees_answer_alike_in_both_forms_gaps_and_splits_included(target: Target) -> None:
    runs = made_up_runs(600)
    trees = grow_trees(
        runs.features, runs.labels["label_mu"], FitParameters(trees_count=40, target=target), threads_count=1
    )
    former = former_trees(trees)
    compact = with_compact_trees(former)
    (node,) = (node for node in compact.graph.node if node.op_type == "TreeEnsemble")
    said = {entry.name: helper.get_attribute_value(entry) for entry in node.attribute}
    splits = onnx.numpy_helper.to_array(said["nodes_splits"])
    rows = rows_with_gaps(runs.features.shape[1])
    # A value on a split tells "less" from "at most".
    rows[np.arange(len(rows)), np.resize(said["nodes_featureids"], len(rows))] = np.resize(splits, len(rows))
    mixed = np.vstack([rows, runs.features, rows_with_gaps(runs.features.shape[1])])
    assert np.array_equal(answers_of(compact, mixed), answers_of(former, mixed))
    assert len(np.unique(answers_of(compact, mixed))) > 100
    assert compact.ByteSize() < former.ByteSize() / 2


def small_trees(**changes: object) -> onnx.ModelProto:
    """Two trees: at most 1 in column 0 gives 0.25, else 0.5, a gap 0.25; and one that is a leaf of 2 only."""
    said: dict[str, object] = {
        "nodes_treeids": [0, 0, 0, 1],
        "nodes_nodeids": [0, 1, 2, 0],
        "nodes_featureids": [0, 0, 0, 0],
        "nodes_modes": ["BRANCH_LEQ", "LEAF", "LEAF", "LEAF"],
        "nodes_values": [1.0, 0.0, 0.0, 0.0],
        "nodes_truenodeids": [1, 0, 0, 0],
        "nodes_falsenodeids": [2, 0, 0, 0],
        "nodes_missing_value_tracks_true": [1, 0, 0, 0],
        "target_treeids": [0, 0, 1],
        "target_nodeids": [1, 2, 0],
        "target_ids": [0, 0, 0],
        "target_weights": [0.25, 0.5, 2.0],
        "base_values": [4.0],
        "n_targets": 1,
    } | changes
    said = {name: value for name, value in said.items() if value is not None}
    trees = helper.make_node("TreeEnsembleRegressor", ["rows"], ["sum"], domain="ai.onnx.ml", **said)
    graph = helper.make_graph(
        [trees, helper.make_node("Neg", ["sum"], ["answer"])],
        "small",
        [helper.make_tensor_value_info("rows", TensorProto.FLOAT, [None, COLUMNS])],
        [helper.make_tensor_value_info("answer", TensorProto.FLOAT, [None, 1])],
    )
    return helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 15), helper.make_opsetid("ai.onnx.ml", 1)], ir_version=8
    )


ROWS = np.array([[1.0, 0.0, 0.0], [1.5, 0.0, 0.0], [np.nan, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("changes", "answers"),
    [
        ({}, [-6.25, -6.5, -6.25]),
        ({"base_values": None}, [-2.25, -2.5, -2.25]),
        ({"nodes_missing_value_tracks_true": None}, [-6.25, -6.5, -6.5]),
        ({"nodes_modes": ["BRANCH_LT", "LEAF", "LEAF", "LEAF"]}, [-6.5, -6.5, -6.25]),
        # A leaf that no weight names adds nothing.
        (
            {"target_treeids": [0, 1], "target_nodeids": [1, 0], "target_ids": [0, 0], "target_weights": [0.25, 2.0]},
            [-6.25, -6.0, -6.25],
        ),
    ],
    ids=["all", "no base", "gaps go the other way", "less than", "a leaf without weight"],
)
def test_each_part_of_a_tree_keeps_its_meaning(changes: dict[str, object], answers: list[float]) -> None:
    former = small_trees(**changes)
    compact = with_compact_trees(former)
    assert answers_of(compact, ROWS).tolist() == answers
    assert np.array_equal(answers_of(former, ROWS), answers_of(compact, ROWS))


def test_what_is_not_a_tree_stays_and_the_model_given_is_not_changed() -> None:
    former = small_trees()
    before = former.SerializeToString()
    compact = with_compact_trees(former)
    assert operators_of(compact) == ["TreeEnsemble", "Add", "Neg"]
    assert (compact.graph.input, compact.graph.output) == (former.graph.input, former.graph.output)
    assert former.SerializeToString() == before


def test_small_trees_stay_as_they_are() -> None:
    compact = with_compact_trees(small_trees())
    assert with_compact_trees(compact) == compact


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_targets": 2, "target_ids": [0, 1, 0]}, "more than one number per row"),
        ({"aggregate_function": "AVERAGE"}, "anything but a sum"),
        ({"post_transform": "LOGISTIC"}, "a sum that is transformed"),
        ({"nodes_modes": ["BRANCH_MEMBER", "LEAF", "LEAF", "LEAF"]}, "compare by"),
        ({"nodes_nodeids": [0, 1, 1, 0]}, "one number"),
        ({"nodes_truenodeids": [7, 0, 0, 0]}, "not there"),
        ({"nodes_truenodeids": [0, 0, 0, 0]}, "its root"),
    ],
)
def test_trees_of_another_kind_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(BundleError, match=message):
        with_compact_trees(small_trees(**changes))
