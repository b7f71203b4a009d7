"""Tiny model bundles whose answers a test can foretell: linear models of a few features."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from roadgrip.bundle import (
    MANIFEST_NAME,
    BundleManifest,
    Conformal,
    Envelope,
    GoldenVectors,
    ModelManifest,
    OrdinaryDriving,
    bundle_id_of,
)
from roadgrip.bundle_json import manifest_to_json
from roadgrip.envelope import DrivingEnvelope
from roadgrip.features import NEWEST_TABLE, FeatureTable
from roadgrip.units import FloatArray

MODEL_NAME = "model.onnx"
ERROR_NAME = "error.onnx"
BIAS_MU = 0.5
WEIGHTS: Mapping[str, float] = {"sideslip_mean_rad": 1.0}
"""By default a model answers 0.5 plus the mean sideslip, so that a passage can carry any friction into a test."""
ERROR_BIAS_RATIO = 0.05
ERROR_WEIGHTS: Mapping[str, float] = {"steer_mean_rad": 1.0}
"""The expected error is 5 % plus the mean steering angle, so that a passage can carry that, too."""
CONFORMAL = Conformal(coverage_frac=0.9, quantile=2.0, doubtful_above_ratio=0.2)


def linear_mu(
    rows: FloatArray,
    *,
    weights: Mapping[str, float] = WEIGHTS,
    bias_mu: float = BIAS_MU,
    table: FeatureTable = NEWEST_TABLE,
) -> FloatArray:
    column = np.array([weights.get(name, 0.0) for name in table.names])
    return np.asarray(rows @ column + bias_mu, dtype=np.float64)


def linear_onnx(
    *, weights: Mapping[str, float] = WEIGHTS, bias_mu: float = BIAS_MU, table: FeatureTable = NEWEST_TABLE
) -> bytes:
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    column = np.array([[weights.get(name, 0.0)] for name in table.names], dtype=np.float32)
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["features", "weights", "bias"], ["mu"])],
        "linear",
        [helper.make_tensor_value_info("features", TensorProto.FLOAT, [None, len(table)])],
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


def error_onnx(table: FeatureTable = NEWEST_TABLE) -> bytes:
    return linear_onnx(weights=ERROR_WEIGHTS, bias_mu=ERROR_BIAS_RATIO, table=table)


def golden_vectors(
    *,
    weights: Mapping[str, float] = WEIGHTS,
    bias_mu: float = BIAS_MU,
    table: FeatureTable = NEWEST_TABLE,
    with_error: bool = False,
) -> GoldenVectors:
    low, high = np.maximum(table.minimum, -10.0), np.minimum(table.maximum, 10.0)
    rows = np.array([np.maximum(low, high * share) for share in (0.0, 0.02, 0.05, 0.1)])
    rows[:, table.index("section_length_m")] = 100.0
    rows = rows.astype(np.float32).astype(np.float64)
    errors = linear_mu(rows, weights=ERROR_WEIGHTS, bias_mu=ERROR_BIAS_RATIO, table=table)
    return GoldenVectors(
        rows=tuple(tuple(float(v) for v in row) for row in rows),
        mu=tuple(float(v) for v in linear_mu(rows, weights=weights, bias_mu=bias_mu, table=table)),
        expected_error_ratio=tuple(float(v) for v in errors) if with_error else None,
    )


def make_ordinary() -> OrdinaryDriving:
    """Roads of 50 to 600 m, on which more speed goes with more steering to the left."""
    return OrdinaryDriving(
        road_columns=("section_length_m",),
        road=Envelope(lower=(50.0,), upper=(600.0,), outside_allowed_count=0),
        driving=DrivingEnvelope(
            columns=("speed_mean_mps", "steer_mean_rad"),
            lower=(10.0, -0.1),
            upper=(20.0, 0.1),
            cut_ratio=5.0,
            share_frac=(1.0,),
            middle_ratio=((0.0, 0.0),),
            whitening_ratio=(((1.0, 0.0), (-5.0, 5.0)),),
            limit_level=8.0,
        ),
    )


def make_model(
    *,
    weights: Mapping[str, float] = WEIGHTS,
    bias_mu: float = BIAS_MU,
    mu_range: tuple[float, float] = (0.1, 1.0),
    envelope: Envelope | None = None,
    table: FeatureTable = NEWEST_TABLE,
    conformal: Conformal | None = None,
) -> ModelManifest:
    """Return what a model says about itself; with `conformal` it has one for its error, too."""
    everywhere = Envelope(
        lower=tuple(float(v) for v in table.minimum),
        upper=tuple(float(v) for v in table.maximum),
        outside_allowed_count=0,
    )
    prefix = "" if table is NEWEST_TABLE else f"table-{table.version}-"
    return ModelManifest(
        table_digest=table.digest,
        feature_names=table.names,
        model_file=f"{prefix}{MODEL_NAME}",
        error_model_file=None if conformal is None else f"{prefix}{ERROR_NAME}",
        mu_range=mu_range,
        envelope=envelope or everywhere,
        golden=golden_vectors(weights=weights, bias_mu=bias_mu, table=table, with_error=conformal is not None),
        conformal=conformal,
    )


def manifest_of(models: Sequence[ModelManifest], files: Mapping[str, bytes], *, name: str = "linear") -> BundleManifest:
    files_sha256 = {file: hashlib.sha256(content).hexdigest() for file, content in files.items()}
    return BundleManifest(
        name=name,
        bundle_id=bundle_id_of(models, files_sha256),
        models=tuple(models),
        metrics={},
        provenance={"made_by": "a test"},
        files_sha256=files_sha256,
    )


def make_manifest(
    *,
    model: bytes | None = None,
    name: str = "linear",
    weights: Mapping[str, float] = WEIGHTS,
    bias_mu: float = BIAS_MU,
    mu_range: tuple[float, float] = (0.1, 1.0),
    envelope: Envelope | None = None,
    conformal: Conformal | None = None,
) -> BundleManifest:
    """Return the manifest of a bundle with one model, for the newest table."""
    manifest = make_model(weights=weights, bias_mu=bias_mu, mu_range=mu_range, envelope=envelope, conformal=conformal)
    files = {MODEL_NAME: linear_onnx(weights=weights, bias_mu=bias_mu) if model is None else model}
    if conformal is not None:
        files[ERROR_NAME] = error_onnx()
    return manifest_of([manifest], files, name=name)


def make_bundle_of_tables(
    folder: Path, tables: Sequence[FeatureTable], *, biases_mu: Sequence[float]
) -> BundleManifest:
    """Write a bundle with a linear model and its expected error for each table, and return its manifest.

    Args:
        folder: Made if missing.
        tables: Which to serve.
        biases_mu: What each model answers to a row of zeros, to tell them apart.
    """
    models, files = [], {}
    for table, bias_mu in zip(tables, biases_mu, strict=True):
        manifest = make_model(bias_mu=bias_mu, table=table, conformal=CONFORMAL)
        models.append(manifest)
        files[manifest.model_file] = linear_onnx(bias_mu=bias_mu, table=table)
        files[str(manifest.error_model_file)] = error_onnx(table)
    return _written(folder, manifest_of(models, files), files)


def make_bundle_with_local(folder: Path, section_id: str, *, global_mu: float, local_mu: float) -> BundleManifest:
    """Write a bundle with a global model and one for a single section, told apart by what they answer to zeros."""
    everywhere = make_model(bias_mu=global_mu)
    here = replace(make_model(bias_mu=local_mu), section_id=section_id, model_file=f"local-{MODEL_NAME}")
    files = {everywhere.model_file: linear_onnx(bias_mu=global_mu), here.model_file: linear_onnx(bias_mu=local_mu)}
    return _written(folder, manifest_of([everywhere, here], files), files)


def _written(folder: Path, manifest: BundleManifest, files: Mapping[str, bytes]) -> BundleManifest:
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / MANIFEST_NAME).write_text(manifest_to_json(manifest), encoding="utf-8")
    return manifest


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
    return _written(folder, manifest, {MODEL_NAME: model})
