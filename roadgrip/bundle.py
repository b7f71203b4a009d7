"""What a model bundle must say about itself.

A bundle is a folder: `manifest.json`, `model.onnx`, and nothing that is not named in the manifest with its SHA-256.
The manifest holds everything a road side unit needs to trust the model before the first passage: the feature table
it was made for, the envelope it was trained in, and golden vectors, rows with the answers the model gave in the
laboratory.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any

from roadgrip.errors import BundleError
from roadgrip.features import FEATURE_NAMES, check_digest

MANIFEST_NAME = "manifest.json"
FORMAT_VERSION = 1
GOLDEN_TOLERANCE_MU = 1e-5
"""How far the model may answer from its golden vectors on other hardware."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """The region of feature space the model was trained in.

    Attributes:
        lower: Lower edge per feature, in the order of the table.
        upper: Upper edge per feature.
        outside_allowed_count: Features that may lie outside before a passage counts as outside; more than zero,
            since among 78 features of an ordinary passage some lie beyond any quantile.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    outside_allowed_count: int


@dataclass(frozen=True, slots=True)
class GoldenVectors:
    """Feature rows and the friction the model gave for them in the laboratory."""

    rows: tuple[tuple[float, ...], ...]
    mu: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class BundleManifest:
    """The manifest of a bundle.

    Attributes:
        name: Name of the bundle, such as "roadgrip-global".
        bundle_id: First 16 hexadecimal characters of the model's SHA-256; names the model in every stored estimate.
        table_digest: The feature table it was made for.
        feature_names: The columns in order, for people.
        model_file: Name of the model inside the folder.
        files_sha256: SHA-256 of every other file of the bundle.
        mu_range: Smallest and largest friction it was trained with.
        envelope: Where it was trained.
        golden: Rows with known answers.
        metrics: Figures of merit on data that was not used for training.
        provenance: How it was made: command, data-set digest, seed, versions of the tools.
    """

    name: str
    bundle_id: str
    table_digest: str
    feature_names: tuple[str, ...]
    model_file: str
    files_sha256: dict[str, str]
    mu_range: tuple[float, float]
    envelope: Envelope
    golden: GoldenVectors
    metrics: dict[str, float]
    provenance: dict[str, str]


def manifest_to_json(manifest: BundleManifest) -> str:
    """Return the manifest as JSON text that `manifest_from_json` reads back to an equal record."""
    return json.dumps({"format_version": FORMAT_VERSION, **asdict(manifest)}, indent=1, sort_keys=True) + "\n"


def manifest_from_json(text: str) -> BundleManifest:
    """Return the manifest that a JSON text holds.

    Raises:
        BundleError: The text is no manifest, or contradicts itself; the message says where.
        FeatureTableError: The bundle was made for another feature table.
    """
    try:
        raw: dict[str, Any] = json.loads(text)
        if raw["format_version"] != FORMAT_VERSION:
            message = f"bundle format {raw['format_version']}, this software reads {FORMAT_VERSION}"
            raise BundleError(message)
        manifest = BundleManifest(
            name=str(raw["name"]),
            bundle_id=str(raw["bundle_id"]),
            table_digest=str(raw["table_digest"]),
            feature_names=tuple(str(n) for n in raw["feature_names"]),
            model_file=str(raw["model_file"]),
            files_sha256={str(k): str(v) for k, v in raw["files_sha256"].items()},
            mu_range=(float(raw["mu_range"][0]), float(raw["mu_range"][1])),
            envelope=Envelope(
                lower=tuple(float(v) for v in raw["envelope"]["lower"]),
                upper=tuple(float(v) for v in raw["envelope"]["upper"]),
                outside_allowed_count=int(raw["envelope"]["outside_allowed_count"]),
            ),
            golden=GoldenVectors(
                rows=tuple(tuple(float(v) for v in row) for row in raw["golden"]["rows"]),
                mu=tuple(float(v) for v in raw["golden"]["mu"]),
            ),
            metrics={str(k): float(v) for k, v in raw["metrics"].items()},
            provenance={str(k): str(v) for k, v in raw["provenance"].items()},
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        message = f"not a bundle manifest: {type(error).__name__} at {error}"
        raise BundleError(message) from error
    _check(manifest)
    return manifest


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


def _check(manifest: BundleManifest) -> None:
    check_digest(manifest.table_digest, subject=f"bundle {manifest.bundle_id}")
    width = len(FEATURE_NAMES)
    golden = manifest.golden
    problems = {
        "the feature names are not the table's": manifest.feature_names != FEATURE_NAMES,
        "the model file has no digest": manifest.model_file not in manifest.files_sha256,
        "the envelope has another width": {len(manifest.envelope.lower), len(manifest.envelope.upper)} != {width},
        "the golden vectors do not fit": len(golden.rows) != len(golden.mu) or {len(r) for r in golden.rows} != {width},
        "the friction range is empty": not 0.0 < manifest.mu_range[0] < manifest.mu_range[1],
        "the bundle id is not the model's": manifest.bundle_id
        != manifest.files_sha256.get(manifest.model_file, "")[:16],
    }
    for problem, found in problems.items():
        if found:
            message = f"bundle {manifest.bundle_id}: {problem}"
            raise BundleError(message)
