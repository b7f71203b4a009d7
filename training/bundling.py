"""Fitted regressors become a bundle: models, envelopes, golden vectors, figures of merit, provenance."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xgboost

from roadgrip.bundle import (
    MANIFEST_NAME,
    BundleManifest,
    Conformal,
    Envelope,
    GoldenVectors,
    ModelManifest,
    OrdinaryDriving,
    TrainingReference,
    bundle_id_of,
)
from roadgrip.bundle_json import manifest_from_json, manifest_to_json
from roadgrip.errors import BundleError
from roadgrip.features import FeatureTable
from roadgrip.units import FloatArray
from training.bundle_card import card_of
from training.dataset import Runs
from training.export import check_parity, onnx_estimate_mu, parity_rows, to_onnx
from training.regressor import Fitted

CARD_FILE_NAME = "card.md"
"""What the bundle is for, what it learned from and how good it is, for whoever opens its folder."""
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

    Each side is the 0.1 % quantile of a feature, widened by 5 % of the span between both sides. Among many features
    an ordinary passage has a few beyond any quantile; the number allowed is the smallest with which at most 0.5 %
    of the rows are called outside.

    Args:
        features: Training rows. (n, columns)
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


@dataclass(frozen=True)
class TableModel:
    """Fitted models for one feature table, with everything that goes into a bundle beside them.

    Attributes:
        table: Of all rows below.
        friction: Trees that add up to friction or its logarithm.
        train_rows: Rows the trees learned from; the envelope and the rows of the parity gate come from them.
            (n, columns)
        train_label_mu: Their friction. (n,)
        unseen_rows: Rows they did not learn from; the golden vectors come from them. (m, columns)
        error: Trees that add up to the expected relative error or its logarithm; None without.
        conformal: What the expected error means; given if and only if `error` is.
        column_names: The features that `friction` was grown on, in their order; all of the table's by default.
        error_column_names: The same for `error`.
        ordinary: Roads and driving it is made for (`training.study.envelopes`); without, the box of the training rows
            decides what is counted.
        section_id: The only section it is for; None for a global model.
        references: How its training was distributed (`training.drift.reference`); a unit watches its traffic by them.
    """

    table: FeatureTable
    friction: xgboost.Booster
    train_rows: FloatArray
    train_label_mu: FloatArray
    unseen_rows: FloatArray
    error: xgboost.Booster | None = None
    conformal: Conformal | None = None
    column_names: tuple[str, ...] | None = None
    error_column_names: tuple[str, ...] | None = None
    ordinary: OrdinaryDriving | None = None
    section_id: str | None = None
    references: tuple[TrainingReference, ...] = ()


def write_bundle(
    runs: Runs,
    fitted: Fitted,
    folder: Path,
    *,
    name: str,
    provenance: Mapping[str, str],
    rng: np.random.Generator,
) -> BundleManifest:
    """Write a bundle with one regressor for the table of its runs; see `write_models`.

    Args:
        runs: The runs the regressor was fitted to.
        fitted: The regressor.
        folder: Where the bundle goes; made if missing, files of the same names replaced.
        name: Name of the bundle.
        provenance: How it came about, as text.
        rng: Chance that picks parity rows and golden vectors.

    Raises:
        BundleError: The export does not answer as the trees do; nothing is written.
    """
    model = TableModel(
        table=runs.table,
        friction=fitted.booster,
        train_rows=runs.features[fitted.train_rows],
        train_label_mu=runs.labels["label_mu"][fitted.train_rows],
        unseen_rows=runs.features[fitted.test_rows],
    )
    return write_models(
        [model],
        folder,
        name=name,
        metrics=fitted.metrics,
        provenance={**provenance, "dataset_digest": runs.digest()},
        rng=rng,
    )


def write_models(
    models: Sequence[TableModel],
    folder: Path,
    *,
    name: str,
    metrics: Mapping[str, float],
    provenance: Mapping[str, str],
    rng: np.random.Generator,
) -> BundleManifest:
    """Export the trees, hold them against the originals, and write a bundle that a road side unit can load.

    Args:
        models: A global one per feature table, the newest first: vehicles are offered the tables in this order. Then
            those for single sections.
        folder: Where the bundle goes; made if missing, files of the same names replaced.
        name: Name of the bundle.
        metrics: Figures of merit on data that was not used for training.
        provenance: How it came about, as text.
        rng: Chance that picks parity rows and golden vectors.

    Returns:
        The manifest as written.

    Raises:
        BundleError: An export does not answer as its trees do, or the manifest would contradict itself; nothing is
            written.
    """
    files: dict[str, bytes] = {}
    manifests: list[ModelManifest] = []
    differences: dict[str, float] = {}
    for model in models:
        exported, manifest, difference = _exported(model, rng=rng)
        files |= exported
        manifests.append(manifest)
        differences |= difference
    files_sha256 = {file: hashlib.sha256(content).hexdigest() for file, content in files.items()}
    written = BundleManifest(
        name=name,
        bundle_id=bundle_id_of(manifests, files_sha256),
        models=tuple(manifests),
        metrics={**metrics, **differences},
        provenance=dict(provenance),
        files_sha256=files_sha256,
    )
    card = f"# {name}\n\n{card_of(written)}".encode()
    files[CARD_FILE_NAME] = card
    written = replace(written, files_sha256={**files_sha256, CARD_FILE_NAME: hashlib.sha256(card).hexdigest()})
    text = manifest_to_json(written)
    manifest_from_json(text)
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in files.items():
        (folder / file).write_bytes(content)
    (folder / MANIFEST_NAME).write_text(text, encoding="utf-8")
    return written


def _in_short_numbers(ordinary: OrdinaryDriving) -> OrdinaryDriving:
    """Return the same with whitening matrices of 32-bit numbers, as a manifest packs them."""
    matrices = np.asarray(ordinary.driving.whitening_ratio).astype(np.float32).astype(np.float64)
    return replace(ordinary, driving=replace(ordinary.driving, whitening_ratio=matrices))


def _golden_rows(model: TableModel, *, rng: np.random.Generator) -> FloatArray:
    """Return rows that the models never saw, as the 32-bit numbers a unit gives to them."""
    low, high = model.table.minimum.astype(np.float32), model.table.maximum.astype(np.float32)
    rows = model.unseen_rows.astype(np.float32)
    # A unit refuses whatever leaves the table's ranges, and would refuse a bundle that asks for it.
    rows = rows[((rows >= low) & (rows <= high)).all(axis=1)]
    if len(rows) == 0:
        message = "no row that the models never saw lies within the feature table's ranges; nothing can prove them"
        raise BundleError(message)
    picked = rng.choice(len(rows), min(GOLDEN_ROWS_COUNT, len(rows)), replace=False)
    return rows[picked].astype(np.float64)


def _exported(
    model: TableModel, *, rng: np.random.Generator
) -> tuple[dict[str, bytes], ModelManifest, dict[str, float]]:
    """Return a model's files, what its manifest says, and how far the exports are from their trees."""
    version = f"v{model.table.version}" + ("" if model.section_id is None else f"-{model.section_id}")
    friction_file, error_file = f"friction-{version}.onnx", f"error-{version}.onnx"
    rows = parity_rows(model.train_rows, rng=rng, table=model.table)
    golden_rows = _golden_rows(model, rng=rng)

    def export(trees: xgboost.Booster, column_names: tuple[str, ...] | None) -> tuple[bytes, float]:
        content = to_onnx(trees, table=model.table, column_names=column_names)
        return content, check_parity(trees, content, rows, table=model.table, column_names=column_names)

    friction, difference_mu = export(model.friction, model.column_names)
    files, differences = {friction_file: friction}, {f"onnx_difference_mu.{version}": difference_mu}
    errors: tuple[float, ...] | None = None
    if model.error is not None:
        files[error_file], differences[f"onnx_difference_ratio.{version}"] = export(
            model.error, model.error_column_names
        )
        errors = tuple(onnx_estimate_mu(files[error_file], golden_rows).tolist())
    manifest = ModelManifest(
        table_digest=model.table.digest,
        feature_names=model.table.names,
        model_file=friction_file,
        error_model_file=None if model.error is None else error_file,
        mu_range=(float(model.train_label_mu.min()), float(model.train_label_mu.max())),
        envelope=learn_envelope(model.train_rows),
        golden=GoldenVectors(
            rows=tuple(tuple(float(v) for v in row) for row in golden_rows),
            mu=tuple(onnx_estimate_mu(friction, golden_rows).tolist()),
            expected_error_ratio=errors,
        ),
        conformal=model.conformal,
        ordinary=None if model.ordinary is None else _in_short_numbers(model.ordinary),
        section_id=model.section_id,
        references=model.references,
    )
    return files, manifest, differences
