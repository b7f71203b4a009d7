"""From trees to ONNX, with a gate: the exported model must answer as the trained one does.

Converters have been seen to be silently wrong for some objectives, by more than the whole range of friction. So no
model leaves the laboratory before both have answered the same rows, edges included.
"""

from __future__ import annotations

import numpy as np
import onnxruntime
import xgboost
from onnxmltools.convert import convert_xgboost
from onnxmltools.convert.common.data_types import FloatTensorType

from roadgrip.errors import BundleError
from roadgrip.features import FEATURES
from roadgrip.units import FloatArray
from training.regressor import estimate_mu

PARITY_TOLERANCE_MU = 1e-5
PARITY_FEWEST_ROWS = 1000
OPSET = 15


def to_onnx(booster: xgboost.Booster) -> bytes:
    """Return the trees as an ONNX model with one input (n, 78) and one output (n, 1), both float32."""
    width = len(FEATURES)
    # Without a name of its own the graph gets a random one, and the same trees another digest each time.
    model = convert_xgboost(
        booster, name="roadgrip", initial_types=[("features", FloatTensorType([None, width]))], target_opset=OPSET
    )
    content: bytes = model.SerializeToString()
    return content


def parity_rows(features: FloatArray, *, rng: np.random.Generator) -> FloatArray:
    """Return rows on which both models must agree: real ones, mixtures, the edges of the table and beyond real ones.

    Args:
        features: Real rows. (n, 78)
        rng: Chance that picks and mixes.

    Returns:
        At least `PARITY_FEWEST_ROWS` rows.
    """
    count = max(PARITY_FEWEST_ROWS, min(len(features), 4000))
    real = features[rng.integers(0, len(features), count)]
    # Values from different rows side by side reach leaves that no real passage reaches.
    mixed = np.column_stack([rng.permutation(real[:, i]) for i in range(real.shape[1])])
    low = np.array([f.minimum for f in FEATURES])
    high = np.array([f.maximum for f in FEATURES])
    edges = np.vstack([low, high, (low + high) / 2.0, np.zeros_like(low)])
    uniform = low + (high - low) * rng.random((200, len(low)))
    return np.vstack([real, mixed, edges, uniform])


def check_parity(booster: xgboost.Booster, model: bytes, rows: FloatArray) -> float:
    """Return the largest difference between the trees and their export over the rows.

    Raises:
        BundleError: There are too few rows to tell, or some answer differs by more than `PARITY_TOLERANCE_MU`.
    """
    if len(rows) < PARITY_FEWEST_ROWS:
        raise BundleError(f"parity on {len(rows)} rows proves nothing; give at least {PARITY_FEWEST_ROWS}")
    difference = float(np.abs(estimate_mu(booster, rows) - onnx_estimate_mu(model, rows)).max())
    if not difference <= PARITY_TOLERANCE_MU:
        raise BundleError(f"the exported model differs from the trained one by {difference:.2e}; it is not released")
    return difference


def onnx_estimate_mu(model: bytes, rows: FloatArray) -> FloatArray:
    """Return what an ONNX model answers for rows of features: (n, 78) in, (n,) out."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    answers = session.run(None, {name: rows.astype(np.float32)})[0]
    return np.asarray(answers, dtype=np.float64).reshape(-1)
