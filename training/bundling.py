"""A fitted regressor becomes a bundle: model, envelope, golden vectors, figures of merit, provenance."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from roadgrip.bundle import (
    MANIFEST_NAME,
    BundleManifest,
    Envelope,
    GoldenVectors,
    ModelManifest,
    bundle_id_of,
    manifest_to_json,
)
from roadgrip.features import FEATURE_NAMES, TABLE_DIGEST
from roadgrip.units import FloatArray
from training.dataset import Runs
from training.export import check_parity, onnx_estimate_mu, parity_rows, to_onnx
from training.regressor import Fitted

MODEL_NAME = "model.onnx"
GOLDEN_ROWS_COUNT = 32
ENVELOPE_TAIL_FRAC = 0.001
ENVELOPE_MARGIN_FRAC = 0.05
ROUNDING_RATIO = 1e-6
"""A feature that never changed in training, such as the length of the only road, still differs by its rounding to 32
bits; without this every passage on that road would be strange."""
FALSE_FLAG_FRAC = 0.005
"""Share of ordinary passages that the envelope may wrongly call strange."""


def learn_envelope(features: FloatArray) -> Envelope:
    """Return the box that nearly all training rows lie in, and how many features may leave it.

    Each side is the 0.1 % quantile of a feature, widened by 5 % of the span between both sides. Among 78 features
    an ordinary passage has a few beyond any quantile; the number allowed is the smallest with which at most 0.5 %
    of the rows are called outside.

    Args:
        features: Training rows. (n, 78)
    """
    low, high = np.quantile(features, [ENVELOPE_TAIL_FRAC, 1.0 - ENVELOPE_TAIL_FRAC], axis=0)
    margin = ENVELOPE_MARGIN_FRAC * (high - low) + ROUNDING_RATIO * np.maximum(np.abs(low), np.abs(high))
    lower, upper = low - margin, high + margin
    outside = ((features < lower) | (features > upper)).sum(axis=1)
    allowed = int(np.quantile(outside, 1.0 - FALSE_FLAG_FRAC, method="higher"))
    return Envelope(
        lower=tuple(float(v) for v in lower),
        upper=tuple(float(v) for v in upper),
        outside_allowed_count=allowed,
    )


def write_bundle(
    runs: Runs, fitted: Fitted, folder: Path, *, name: str, provenance: dict[str, str], rng: np.random.Generator
) -> BundleManifest:
    """Export the trees, hold them against the originals, and write a bundle that a road side unit can load.

    Args:
        runs: The runs the regressor was fitted to.
        fitted: The regressor.
        folder: Where the bundle goes; made if missing, files of the same names replaced.
        name: Name of the bundle.
        provenance: How it came about, as text.
        rng: Chance that picks parity rows and golden vectors.

    Returns:
        The manifest as written.

    Raises:
        BundleError: The export does not answer as the trees do; nothing is written.
    """
    model = to_onnx(fitted.booster)
    train = runs.features[fitted.train_rows]
    difference_mu = check_parity(fitted.booster, model, parity_rows(train, rng=rng))
    picked = rng.choice(fitted.test_rows, min(GOLDEN_ROWS_COUNT, len(fitted.test_rows)), replace=False)
    golden_rows = runs.features[picked].astype(np.float32).astype(np.float64)
    label_mu = runs.labels["label_mu"][fitted.train_rows]
    digest = hashlib.sha256(model).hexdigest()
    model_manifest = ModelManifest(
        table_digest=TABLE_DIGEST,
        feature_names=FEATURE_NAMES,
        model_file=MODEL_NAME,
        error_model_file=None,
        mu_range=(float(label_mu.min()), float(label_mu.max())),
        envelope=learn_envelope(train),
        golden=GoldenVectors(
            rows=tuple(tuple(float(v) for v in row) for row in golden_rows),
            mu=tuple(float(v) for v in onnx_estimate_mu(model, golden_rows)),
        ),
        conformal=None,
    )
    files_sha256 = {MODEL_NAME: digest}
    manifest = BundleManifest(
        name=name,
        bundle_id=bundle_id_of((model_manifest,), files_sha256),
        models=(model_manifest,),
        files_sha256=files_sha256,
        metrics={**fitted.metrics, "onnx_difference_mu": difference_mu},
        provenance={**provenance, "dataset_digest": runs.digest()},
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MODEL_NAME).write_bytes(model)
    (folder / MANIFEST_NAME).write_text(manifest_to_json(manifest), encoding="utf-8")
    return manifest
