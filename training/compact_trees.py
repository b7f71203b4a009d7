"""Trees in the small form of ONNX: one entry per branch and one per leaf, numbers instead of names.

The converters write `TreeEnsembleRegressor`, in which every node, leaf or not, carries six numbers of 64 bits and the
name of its comparison. onnxruntime keeps all of that beside the trees it makes of it: with the packaged bundle 16 MB
of a road side unit's memory more than with `TreeEnsemble`, of version 5 of the same operators, which says the same in
two fifths of the bytes. The same additions in the same order give the same answers to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

from roadgrip.errors import BundleError

TREES_DOMAIN = "ai.onnx.ml"
TREES_OPSET = 5
_FORMER = "TreeEnsembleRegressor"
_BARE_SUM = "bare_sum"
_BASE = "base_value"
_COMPARISONS: Mapping[str, int] = {
    "BRANCH_LEQ": 0,
    "BRANCH_LT": 1,
    "BRANCH_GTE": 2,
    "BRANCH_GT": 3,
    "BRANCH_EQ": 4,
    "BRANCH_NEQ": 5,
}
_LEAF = "LEAF"
_SUM = 1
_NO_TRANSFORM = 0

_Numbers = NDArray[np.int64]


def with_compact_trees(model: onnx.ModelProto) -> onnx.ModelProto:
    """Return a model with its trees in the small form; all else as it is, and so are its answers, to the bit.

    A model without trees of the former kind, or whose trees are small already, comes back as an equal copy.

    Args:
        model: Each of its tree ensembles adds up one 32-bit number per row.

    Raises:
        BundleError: Its trees are of a kind that no regressor of ours is.
    """
    compact = onnx.ModelProto()
    compact.CopyFrom(model)
    graph = compact.graph
    if all(node.op_type != _FORMER for node in graph.node):
        return compact
    nodes: list[onnx.NodeProto] = []
    for place, node in enumerate(graph.node):
        if node.op_type != _FORMER:
            nodes.append(node)
            continue
        said = {entry.name: helper.get_attribute_value(entry) for entry in node.attribute}
        _check_kind(said)
        base_values = said.get("base_values", ())
        (rows,), (answer,) = node.input, node.output
        if not len(base_values):
            nodes.append(_tree_node(said, rows, answer, name=node.name))
            continue
        bare, base = f"{_BARE_SUM}_{place}", f"{_BASE}_{place}"
        graph.initializer.append(numpy_helper.from_array(np.array(base_values, dtype=np.float32), base))
        nodes += [
            _tree_node(said, rows, bare, name=node.name),
            helper.make_node("Add", [bare, base], [answer], name=f"base_{place}"),
        ]
    del graph.node[:]
    graph.node.extend(nodes)
    _ask_for_operators(compact)
    onnx.checker.check_model(compact)
    return compact


def _check_kind(said: Mapping[str, Any]) -> None:
    strange = {
        "more than one number per row": said.get("n_targets", 1) != 1 or any(said["target_ids"]),
        "anything but a sum": said.get("aggregate_function", b"SUM") != b"SUM",
        "a sum that is transformed": said.get("post_transform", b"NONE") != b"NONE",
        "numbers of 64 bits": any(name.endswith("_as_tensor") for name in said),
        "several base values": len(said.get("base_values", ())) > 1,
    }
    for kind, found in strange.items():
        if found:
            raise BundleError(f"trees that give {kind} have no small form")


def _tree_node(said: Mapping[str, Any], rows: str, answer: str, *, name: str) -> onnx.NodeProto:
    trees, ids = _numbers(said["nodes_treeids"]), _numbers(said["nodes_nodeids"])
    comparisons = np.array([entry.decode() for entry in said["nodes_modes"]])
    if unknown := set(comparisons.tolist()) - {_LEAF, *_COMPARISONS}:
        raise BundleError(f"trees that compare by {sorted(unknown)} have no small form")
    is_leaf = comparisons == _LEAF
    # Branches and leaves are numbered apart, each in the order they are listed.
    number = np.where(is_leaf, np.cumsum(is_leaf), np.cumsum(~is_leaf)) - 1
    places = _places(trees, ids)

    def found(of_trees: _Numbers, wanted: _Numbers) -> _Numbers:
        try:
            return _numbers([places[key] for key in zip(of_trees.tolist(), wanted.tolist(), strict=True)])
        except KeyError as error:
            raise BundleError(f"tree and node {error} are named, and are not there") from error

    is_branch = ~is_leaf
    when_true = found(trees[is_branch], _numbers(said["nodes_truenodeids"])[is_branch])
    when_false = found(trees[is_branch], _numbers(said["nodes_falsenodeids"])[is_branch])
    weights = np.zeros(int(is_leaf.sum()), dtype=np.float32)
    weighed = found(_numbers(said["target_treeids"]), _numbers(said["target_nodeids"]))
    np.add.at(weights, number[weighed], np.array(said["target_weights"], dtype=np.float32))

    is_root = np.ones(len(trees), dtype=bool)
    is_root[when_true] = is_root[when_false] = False
    roots = np.flatnonzero(is_root)
    # The former kind begins each tree at the node that is listed first.
    if roots.tolist() != np.sort(np.unique(trees, return_index=True)[1]).tolist():
        raise BundleError("a tree does not begin at its root")
    # A tree that is one leaf has no branch to begin at: it gets one, both ways of which lead to the leaf.
    bare = roots[is_leaf[roots]]
    none = np.zeros(len(bare), dtype=np.int64)
    branches_count = int(is_branch.sum())
    starts = number[roots]
    starts[is_leaf[roots]] = branches_count + np.arange(len(bare))
    missing = said.get("nodes_missing_value_tracks_true") or np.zeros(len(trees), dtype=np.int64)
    modes = np.array([_COMPARISONS[entry] for entry in comparisons[is_branch].tolist()], dtype=np.uint8)
    splits = np.array(said["nodes_values"], dtype=np.float32)[is_branch]
    return helper.make_node(
        "TreeEnsemble",
        [rows],
        [answer],
        name=name,
        domain=TREES_DOMAIN,
        n_targets=1,
        aggregate_function=_SUM,
        post_transform=_NO_TRANSFORM,
        tree_roots=starts.tolist(),
        nodes_featureids=[*_numbers(said["nodes_featureids"])[is_branch].tolist(), *none.tolist()],
        nodes_splits=numpy_helper.from_array(np.append(splits, none).astype(np.float32)),
        nodes_modes=numpy_helper.from_array(np.append(modes, none).astype(np.uint8)),
        nodes_truenodeids=np.append(number[when_true], number[bare]).tolist(),
        nodes_falsenodeids=np.append(number[when_false], number[bare]).tolist(),
        nodes_trueleafs=np.append(is_leaf[when_true], none + 1).astype(np.int64).tolist(),
        nodes_falseleafs=np.append(is_leaf[when_false], none + 1).astype(np.int64).tolist(),
        nodes_missing_value_tracks_true=np.append(_numbers(missing)[is_branch], none).tolist(),
        leaf_targetids=[0] * len(weights),
        leaf_weights=numpy_helper.from_array(weights),
    )


def _places(trees: _Numbers, ids: _Numbers) -> dict[tuple[int, int], int]:
    places = {key: place for place, key in enumerate(zip(trees.tolist(), ids.tolist(), strict=True))}
    if len(places) != len(trees):
        raise BundleError("two nodes of a tree have one number")
    return places


def _numbers(listed: Any) -> _Numbers:
    return np.asarray(listed, dtype=np.int64)


def _ask_for_operators(model: onnx.ModelProto) -> None:
    """Let a model say which operators it is written in, and by which version of the format."""
    for entry in model.opset_import:
        if entry.domain == TREES_DOMAIN:
            entry.version = TREES_OPSET
    model.ir_version = max(model.ir_version, helper.find_min_ir_version_for(list(model.opset_import)))
