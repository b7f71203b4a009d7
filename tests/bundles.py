"""Tiny model bundles whose answers a test can foretell: a linear model of a few features."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from roadgrip.bundle import MANIFEST_NAME, BundleManifest, Envelope, GoldenVectors, manifest_to_json
from roadgrip.features import FEATURE_NAMES, FEATURES, TABLE_DIGEST
from roadgrip.units import FloatArray

MODEL_NAME = "model.onnx"
BIAS_MU = 0.5
WEIGHTS: Mapping[str, float] = {"sideslip_mean_rad": 1.0}
"""By default a model answers 0.5 plus the mean sideslip, so that a passage can carry any friction into a test."""


def linear_mu(rows: FloatArray, *, weights: Mapping[str, float] = WEIGHTS, bias_mu: float = BIAS_MU) -> FloatArray:
    column = np.array([weights.get(name, 0.0) for name in FEATURE_NAMES])
    return np.asarray(rows @ column + bias_mu, dtype=np.float64)


def linear_onnx(*, weights: Mapping[str, float] = WEIGHTS, bias_mu: float = BIAS_MU) -> bytes:
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    column = np.array([[weights.get(name, 0.0)] for name in FEATURE_NAMES], dtype=np.float32)
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["features", "weights", "bias"], ["mu"])],
        "linear",
        [helper.make_tensor_value_info("features", TensorProto.FLOAT, [None, len(FEATURE_NAMES)])],
        [helper.make_tensor_value_info("mu", TensorProto.FLOAT, [None, 1])],
        [
            numpy_helper.from_array(column, "weights"),
            numpy_helper.from_array(np.array([bias_mu], dtype=np.float32), "bias"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 15)], ir_version=8)
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


def golden_vectors(*, weights: Mapping[str, float] = WEIGHTS, bias_mu: float = BIAS_MU) -> GoldenVectors:
    low = np.array([max(f.minimum, -10.0) for f in FEATURES])
    high = np.array([min(f.maximum, 10.0) for f in FEATURES])
    rows = np.array([np.maximum(low, high * share) for share in (0.0, 0.02, 0.05, 0.1)])
    rows[:, -1] = 100.0  # the length of the section
    rows = rows.astype(np.float32).astype(np.float64)
    return GoldenVectors(
        rows=tuple(tuple(float(v) for v in row) for row in rows),
        mu=tuple(float(v) for v in linear_mu(rows, weights=weights, bias_mu=bias_mu)),
    )


def make_manifest(
    *,
    model: bytes | None = None,
    name: str = "linear",
    weights: Mapping[str, float] = WEIGHTS,
    bias_mu: float = BIAS_MU,
    mu_range: tuple[float, float] = (0.1, 1.0),
    envelope: Envelope | None = None,
) -> BundleManifest:
    content = linear_onnx(weights=weights, bias_mu=bias_mu) if model is None else model
    digest = hashlib.sha256(content).hexdigest()
    everywhere = Envelope(
        lower=tuple(f.minimum for f in FEATURES), upper=tuple(f.maximum for f in FEATURES), outside_allowed_count=0
    )
    return BundleManifest(
        name=name,
        bundle_id=digest[:16],
        table_digest=TABLE_DIGEST,
        feature_names=FEATURE_NAMES,
        model_file=MODEL_NAME,
        files_sha256={MODEL_NAME: digest},
        mu_range=mu_range,
        envelope=envelope or everywhere,
        golden=golden_vectors(weights=weights, bias_mu=bias_mu),
        metrics={},
        provenance={"made_by": "a test"},
    )


def make_bundle(
    folder: Path,
    *,
    name: str = "linear",
    weights: Mapping[str, float] = WEIGHTS,
    bias_mu: float = BIAS_MU,
    mu_range: tuple[float, float] = (0.1, 1.0),
    envelope: Envelope | None = None,
) -> BundleManifest:
    """Write a bundle that a road side unit loads, and return its manifest.

    Args:
        folder: Made if missing.
        name: Name of the bundle.
        weights: Factor per feature name; features that are not named do not matter.
        bias_mu: What the model answers to a row of zeros.
        mu_range: Smallest and largest friction the bundle says it was trained with.
        envelope: Where it says it was trained; the whole table if left out.
    """
    model = linear_onnx(weights=weights, bias_mu=bias_mu)
    manifest = make_manifest(
        model=model, name=name, weights=weights, bias_mu=bias_mu, mu_range=mu_range, envelope=envelope
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MODEL_NAME).write_bytes(model)
    (folder / MANIFEST_NAME).write_text(manifest_to_json(manifest), encoding="utf-8")
    return manifest
