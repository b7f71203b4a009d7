"""What a model bundle must say about itself; `roadgrip.bundle_json` writes it down.

A bundle is a folder: `manifest.json`, model files, and nothing that is not named in the manifest with its SHA-256. It
holds one friction model per feature table it serves, each perhaps with a second model that expects the first one's
error; beside these global models it may hold some for single sections, which take their place there. The manifest holds
everything a road side unit needs to trust them before the first passage: the feature table of each, the envelope it was
trained in, golden vectors, rows with the answers it gave in the laboratory, and how the features of its training were
distributed, so that a unit can tell when its traffic is no longer like that.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from itertools import pairwise
from math import exp, isfinite, isnan
from typing import Any

from roadgrip.envelope import DrivingEnvelope
from roadgrip.errors import BundleError
from roadgrip.features import table_of

MANIFEST_NAME = "manifest.json"
GOLDEN_TOLERANCE_MU = 1e-5
"""How far a model may answer from its golden vectors on other hardware."""
GOLDEN_TOLERANCE_RATIO = 1e-5
"""The same for the expected error."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """The region of feature space a model was trained in.

    Attributes:
        lower: Lower edge per feature, in the order of the table.
        upper: Upper edge per feature.
        outside_allowed_count: Features that may lie outside before a passage counts as outside; more than zero,
            since among many features of an ordinary passage some lie beyond any quantile.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    outside_allowed_count: int


@dataclass(frozen=True, slots=True)
class OrdinaryDriving:
    """The roads and the driving that a model was made for, asked apart; sharper than a box round every feature.

    Attributes:
        road_columns: Names of the features of the map.
        road: The box that nearly all such roads lie in, features in that order.
        driving: What ordinary drivers do on any road.
    """

    road_columns: tuple[str, ...]
    road: Envelope
    driving: DrivingEnvelope


@dataclass(frozen=True, slots=True)
class GoldenVectors:
    """Feature rows and what the models gave for them in the laboratory.

    Attributes:
        rows: In the order of the table.
        mu: The friction for each row.
        expected_error_ratio: The expected error for each row; None without a model for it.
    """

    rows: tuple[tuple[float, ...], ...]
    mu: tuple[float, ...]
    expected_error_ratio: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Conformal:
    """What turns an expected error into an interval, and a doubtful estimate into "at least".

    The true friction lies between `mu_low` and `mu_high` with the probability `coverage_frac`, over passages like
    those of the calibration, of which the models learned nothing.

    Attributes:
        coverage_frac: Share of the calibration's passages whose true friction lay between the bounds.
        quantile: How many expected errors the bounds are away, on the logarithm of friction.
        doubtful_above_ratio: An estimate with a larger expected error is no estimate: such a passage, which used
            little of the grip there was, only says that the friction is at least its lower bound.

    References:
        Papadopoulos, Proedrou, Vovk, Gammerman, Inductive confidence machines for regression, 2002 (split conformal
        prediction, with nonconformity normalised by an expected error).
    """

    coverage_frac: float
    quantile: float
    doubtful_above_ratio: float

    def mu_low(self, mu: float, *, expected_error_ratio: float) -> float:
        """Return the lower bound of the true friction."""
        return mu * exp(-self.quantile * expected_error_ratio)

    def mu_high(self, mu: float, *, expected_error_ratio: float) -> float:
        """Return the upper bound of the true friction."""
        return mu * exp(self.quantile * expected_error_ratio)

    def at_least(self, *, expected_error_ratio: float) -> bool:
        """Return whether an estimate with this expected error says no more than "at least its lower bound"."""
        return expected_error_ratio > self.doubtful_above_ratio


@dataclass(frozen=True, slots=True)
class TrainingReference:
    """How features and estimates were distributed in training: what a unit's traffic is held against.

    Attributes:
        section_id: The road of the drives it tells of; None for the drives on all roads.
        rows_count: Drives it tells of.
        quantiles: Of each feature in the order of the table, at evenly spaced levels from 0 to 1; never falling.
        mu_quantiles: Of the estimates, at the same levels.
    """

    section_id: str | None
    rows_count: int
    quantiles: tuple[tuple[float, ...], ...]
    mu_quantiles: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ModelManifest:
    """What one model of a bundle says about itself.

    Attributes:
        table_digest: The feature table it was made for.
        feature_names: The columns in order, for people.
        model_file: Name of the friction model inside the folder.
        error_model_file: Name of the model for the expected error; None without one.
        mu_range: Smallest and largest friction it was trained with.
        envelope: Where it was trained.
        golden: Rows with known answers.
        conformal: What the expected error means; None without a model for it.
        ordinary: Takes the place of the envelope where it was learned; None leaves it to the envelope.
        section_id: The only section it is for; None for a global model.
        references: How its training was distributed, over all roads and perhaps on single ones; none in bundles that
            nobody watches.
    """

    table_digest: str
    feature_names: tuple[str, ...]
    model_file: str
    error_model_file: str | None
    mu_range: tuple[float, float]
    envelope: Envelope
    golden: GoldenVectors
    conformal: Conformal | None
    ordinary: OrdinaryDriving | None = None
    section_id: str | None = None
    references: tuple[TrainingReference, ...] = ()

    def reference_for(self, section_id: str) -> TrainingReference | None:
        """Return how the training on a road was distributed; failing that, over all roads; None without either."""
        return next(
            (known for wanted in (section_id, None) for known in self.references if known.section_id == wanted), None
        )

    @property
    def files(self) -> tuple[str, ...]:
        """The model's files, the friction model first."""
        return (self.model_file,) if self.error_model_file is None else (self.model_file, self.error_model_file)


@dataclass(frozen=True, slots=True)
class BundleManifest:
    """The manifest of a bundle.

    Attributes:
        name: Name of the bundle, such as "roadgrip-global".
        bundle_id: See `bundle_id_of`; names the bundle in every stored estimate.
        models: One global one per feature table it serves, at least one; the order is the announced one. Besides, for
            these tables, models for single sections.
        metrics: Figures of merit on data that was not used for training.
        provenance: How it was made: command, data-set digest, seed, versions of the tools.
        files_sha256: SHA-256 of every other file of the bundle.
    """

    name: str
    bundle_id: str
    models: tuple[ModelManifest, ...]
    metrics: dict[str, float]
    provenance: dict[str, str]
    files_sha256: dict[str, str]

    @property
    def table_digests(self) -> tuple[str, ...]:
        """The feature tables it serves, on every section."""
        return tuple(model.table_digest for model in self.models if model.section_id is None)

    def model_for(self, table_digest: str, *, section_id: str | None = None) -> ModelManifest | None:
        """Return what the model for a feature table says about itself; None without one.

        Args:
            table_digest: Of the summary's table.
            section_id: Where it was driven; the section's own model comes first, then the global one.
        """
        fitting = [model for model in self.models if model.table_digest == table_digest]
        return next((model for wanted in (section_id, None) for model in fitting if model.section_id == wanted), None)


def bundle_id_of(models: Sequence[ModelManifest], files_sha256: Mapping[str, str]) -> str:
    """Return the id of a bundle: 16 hexadecimal characters of a SHA-256 over all that decides its answers.

    That is what the models say of themselves, envelopes and meaning of their errors included, and their files; not
    how the bundle is called, how good it was found to be, or how it came about.

    Args:
        models: The bundle's models.
        files_sha256: SHA-256 of every file of the bundle; one that is missing counts as the empty text.
    """
    digest = hashlib.sha256(b"[")
    for place, model in enumerate(models):
        # One after another: the text of all of them would be the largest thing that a unit ever makes.
        said = [model, [files_sha256.get(name, "") for name in model.files]]
        text = json.dumps(said, sort_keys=True, separators=(",", ":"), default=_plain)
        digest.update((text if place == 0 else f",{text}").encode())
    digest.update(b"]")
    return digest.hexdigest()[:16]


def _plain(value: Any) -> dict[str, Any] | list[Any]:
    """Return a record as its fields, an array as lists: what JSON asks for where it does not know better.

    Without copies of all that is inside, as `dataclasses.asdict` would make them.
    """
    if is_dataclass(value):
        return {each.name: getattr(value, each.name) for each in fields(value)}
    listed: list[Any] = value.tolist()
    return listed


def check_files(manifest: BundleManifest, files: dict[str, bytes]) -> None:
    """Do nothing if the files of a bundle are the ones its manifest names, byte for byte.

    Raises:
        BundleError: A file is missing, unknown, or differs.
    """
    if set(files) != set(manifest.files_sha256):
        message = f"bundle holds {sorted(files)}, its manifest names {sorted(manifest.files_sha256)}"
        raise BundleError(message)
    for name, content in files.items():
        if hashlib.sha256(content).hexdigest() != manifest.files_sha256[name]:
            message = f"bundle file {name} differs from its digest in the manifest"
            raise BundleError(message)


def check_manifest(manifest: BundleManifest) -> None:
    """Do nothing if a manifest does not contradict itself.

    Raises:
        BundleError: It does; the message says where.
        FeatureTableError: A model was made for a feature table that this software does not speak.
    """
    files = [name for model in manifest.models for name in model.files]
    problems = {
        "it holds no model": not manifest.models,
        "two models serve one feature table on one section": len(
            {(m.table_digest, m.section_id) for m in manifest.models}
        )
        != len(manifest.models),
        "a section's model serves a feature table that no global model serves": not {
            m.table_digest for m in manifest.models
        }
        <= set(manifest.table_digests),
        "a model file has no digest": not set(files) <= set(manifest.files_sha256),
        "two models share a file": len(set(files)) != len(files),
    }
    _refuse(manifest, problems)
    for model in manifest.models:
        _check_model(manifest, model)
    wrong_id = manifest.bundle_id != bundle_id_of(manifest.models, manifest.files_sha256)
    _refuse(manifest, {"the bundle id is not its models'": wrong_id})


def _check_model(manifest: BundleManifest, model: ModelManifest) -> None:
    table = table_of(model.table_digest, subject=f"bundle {manifest.bundle_id}")
    golden, conformal, width = model.golden, model.conformal, len(table)
    errors, counts = golden.expected_error_ratio, {len(golden.mu), len(golden.rows)}
    has_error_model = model.error_model_file is not None
    problems = {
        "the feature names are not the table's": model.feature_names != table.names,
        "the envelope has another width": {len(model.envelope.lower), len(model.envelope.upper)} != {width},
        "the ordinary driving is not of the table's features": model.ordinary is not None
        and not _fits(model.ordinary, table.names),
        "the golden vectors do not fit": {len(row) for row in golden.rows} != {width}
        or len(counts | (set() if errors is None else {len(errors)})) != 1,
        "the friction range is empty": not 0.0 < model.mu_range[0] < model.mu_range[1],
        "an expected error needs its model, golden answers and meaning": (errors is None, conformal is None)
        != (not has_error_model, not has_error_model),
        "the expected error means nothing": conformal is not None and not _means_something(conformal),
        "a training reference does not fit the table": not all(_refers(known, width) for known in model.references),
        "two training references tell of one road": len({known.section_id for known in model.references})
        != len(model.references),
    }
    _refuse(manifest, problems)


def _fits(ordinary: OrdinaryDriving, feature_names: tuple[str, ...]) -> bool:
    widths = {len(ordinary.road.lower), len(ordinary.road.upper)}
    known = {*ordinary.road_columns, *ordinary.driving.columns} <= set(feature_names)
    return known and widths == {len(ordinary.road_columns)} and not isnan(ordinary.driving.limit_level)


def _refers(reference: TrainingReference, width: int) -> bool:
    rows = (*reference.quantiles, reference.mu_quantiles)
    levels_count = len(reference.mu_quantiles)
    return (
        len(reference.quantiles) == width
        and reference.rows_count > 0
        and levels_count >= 2
        and all(len(row) == levels_count and all(map(isfinite, row)) for row in rows)
        and all(low <= high for row in rows for low, high in pairwise(row))
    )


def _means_something(conformal: Conformal) -> bool:
    return (
        0.0 < conformal.coverage_frac < 1.0
        and conformal.quantile > 0.0
        and isfinite(conformal.quantile)
        and conformal.doubtful_above_ratio > 0.0
        and isfinite(conformal.doubtful_above_ratio)
    )


def _refuse(manifest: BundleManifest, problems: Mapping[str, bool]) -> None:
    for problem, found in problems.items():
        if found:
            message = f"bundle {manifest.bundle_id}: {problem}"
            raise BundleError(message)
