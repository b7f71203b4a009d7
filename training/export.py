"""From trees to ONNX, with a gate: the exported model must answer as the trained one does.

Converters have been seen to be silently wrong for some objectives, by more than the whole range of friction. So no
model leaves the laboratory before both have answered the same rows, edges included. What is compared is the whole
graph: the choice of columns before the trees and the exponential behind them are part of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnx
import onnxruntime
import xgboost
from onnx import TensorProto, helper, numpy_helper
from onnxmltools.convert import convert_xgboost
from onnxmltools.convert.common.data_types import FloatTensorType

from roadgrip.errors import BundleError
from roadgrip.features import NEWEST_TABLE, FeatureTable
from roadgrip.units import FloatArray
from training.compact_trees import with_compact_trees
from training.fit_parameters import Target
from training.regressor import base_column_of, estimate_mu, target_of

PARITY_TOLERANCE_MU = 1e-5
PARITY_FEWEST_ROWS = 1000
OPSET = 15
INPUT_NAME = "features"
OUTPUT_NAME = "answer"


def to_onnx(
    booster: xgboost.Booster, *, table: FeatureTable = NEWEST_TABLE, column_names: Sequence[str] | None = None
) -> bytes:
    """Return trees as an ONNX model with one input (n, columns of the table) and one output (n, 1), both float32.

    Trees that add up to the logarithm get the exponential behind them, so that the model answers in friction (or,
    for a model of the error, in shares of it). The trees are in their small form (`training.compact_trees`), which
    onnxruntime runs from 1.21 on.

    Args:
        booster: The trees.
        table: Of the rows that the model will be asked about.
        column_names: The features the trees were grown on, in their order; all of the table's by default.

    Raises:
        BundleError: The trees were grown on another number of columns.
    """
    width = len(table) if column_names is None else len(column_names)
    if booster.num_features() != width:
        raise BundleError(f"the trees were grown on {booster.num_features()} columns, {width} are named")
    # Without a name of its own the graph gets a random one, and the same trees another digest each time.
    model = convert_xgboost(
        booster, name="roadgrip", initial_types=[(INPUT_NAME, FloatTensorType([None, width]))], target_opset=OPSET
    )
    if target_of(booster) is Target.LOG_MU:
        _append_exponential(model, base_column=base_column_of(booster))
    if column_names is not None:
        _prepend_choice(model, table.columns(column_names).tolist(), width=len(table))
    if not any(entry.domain in {"", "ai.onnx"} for entry in model.opset_import):
        # The trees alone need the operators of machine learning only.
        model.opset_import.append(helper.make_opsetid("", OPSET))
    model = with_compact_trees(model)
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


def parity_rows(features: FloatArray, *, rng: np.random.Generator, table: FeatureTable = NEWEST_TABLE) -> FloatArray:
    """Return rows on which both models must agree: real ones, mixtures, the edges of the table and beyond real ones.

    Args:
        features: Real rows, finite. (n, columns)
        rng: Chance that picks and mixes.
        table: Of the rows.

    Returns:
        At least `PARITY_FEWEST_ROWS` rows.
    """
    count = max(PARITY_FEWEST_ROWS, min(len(features), 4000))
    real = features[rng.integers(0, len(features), count)]
    # Values from different rows side by side reach leaves that no real passage reaches.
    mixed = np.column_stack([rng.permutation(real[:, i]) for i in range(real.shape[1])])
    low, high = table.minimum, table.maximum
    edges = np.vstack([low, high, (low + high) / 2.0, np.zeros_like(low)])
    uniform = low + (high - low) * rng.random((200, len(low)))
    # Real rows with one feature at an end of its range: what lies beyond the last split, feature by feature.
    ends = real[rng.integers(0, count, 2 * len(table))]
    each = np.arange(len(table))
    ends[each, each] = low
    ends[len(table) + each, each] = high
    return np.vstack([real, mixed, edges, uniform, ends])


def check_parity(
    booster: xgboost.Booster,
    model: bytes,
    rows: FloatArray,
    *,
    table: FeatureTable = NEWEST_TABLE,
    column_names: Sequence[str] | None = None,
) -> float:
    """Return the largest difference between the trees and their export over the rows.

    Args:
        booster: The trees.
        model: Their export.
        rows: What both are asked. (n, columns of the table)
        table: Of the rows.
        column_names: The features the trees were grown on; all of the table's by default.

    Raises:
        BundleError: There are too few rows to tell, or some answer differs by more than `PARITY_TOLERANCE_MU`.
    """
    if len(rows) < PARITY_FEWEST_ROWS:
        raise BundleError(f"parity on {len(rows)} rows proves nothing; give at least {PARITY_FEWEST_ROWS}")
    chosen = rows if column_names is None else rows[:, table.columns(column_names)]
    difference = float(np.abs(estimate_mu(booster, chosen) - onnx_estimate_mu(model, rows)).max())
    if not difference <= PARITY_TOLERANCE_MU:
        raise BundleError(f"the exported model differs from the trained one by {difference:.2e}; it is not released")
    return difference


def onnx_estimate_mu(model: bytes, rows: FloatArray) -> FloatArray:
    """Return what an ONNX model answers for rows of features: (n, columns) in, (n,) out."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    answers = session.run(None, {name: rows.astype(np.float32)})[0]
    return np.asarray(answers, dtype=np.float64).reshape(-1)


def _append_exponential(model: onnx.ModelProto, *, base_column: int | None) -> None:
    """Put exp behind the only output, and the product with a column of the trees' input if there is one."""
    graph = model.graph
    (output,) = graph.output
    if base_column is None:
        graph.node.append(helper.make_node("Exp", [output.name], [OUTPUT_NAME], name="exponential"))
    else:
        (whole,) = graph.input
        graph.initializer.append(numpy_helper.from_array(np.array([base_column], dtype=np.int64), "base_column"))
        graph.node.extend(
            [
                helper.make_node("Exp", [output.name], ["ratio"], name="exponential"),
                helper.make_node("Gather", [whole.name, "base_column"], ["base"], name="first_guess", axis=1),
                helper.make_node("Mul", ["ratio", "base"], [OUTPUT_NAME], name="mended_guess"),
            ]
        )
    output.name = OUTPUT_NAME


def _prepend_choice(model: onnx.ModelProto, columns: list[int], *, width: int) -> None:
    """Let the only input take whole rows, of which the trees see some columns."""
    graph = model.graph
    (whole,) = graph.input
    chosen = f"chosen_{whole.name}"
    for node in graph.node:
        for place, name in enumerate(node.input):
            if name == whole.name:
                node.input[place] = chosen
    graph.initializer.append(numpy_helper.from_array(np.array(columns, dtype=np.int64), "columns"))
    graph.node.insert(0, helper.make_node("Gather", [whole.name, "columns"], [chosen], name="choice", axis=1))
    whole.CopyFrom(helper.make_tensor_value_info(whole.name, TensorProto.FLOAT, [None, width]))
