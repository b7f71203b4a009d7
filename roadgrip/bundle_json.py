"""Manifest <-> JSON text, for people as far as they would look.

Lists of numbers stand on one line each. The large matrices of `roadgrip.envelope.DrivingEnvelope`, which nobody reads,
are packed: 32-bit little-endian floats in base64, a fifth of the characters.
"""

from __future__ import annotations

import base64
import binascii
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from roadgrip.bundle import (
    BundleManifest,
    Conformal,
    Envelope,
    GoldenVectors,
    ModelManifest,
    OrdinaryDriving,
    TrainingReference,
    check_manifest,
)
from roadgrip.envelope import DrivingEnvelope
from roadgrip.errors import BundleError
from roadgrip.units import FloatArray

FORMAT_VERSION = 3
_NUMBERS = re.compile(r"\[\s+([^\[\]{}\"]+?)\s+\]")
_PACKED_KEY = "base64_f4"


def manifest_to_json(manifest: BundleManifest) -> str:
    """Return the manifest as JSON text that `manifest_from_json` reads back to an equal record.

    Raises:
        BundleError: A figure of a whitening matrix is no 32-bit number, and would not come back as it is.
    """
    raw = {"format_version": FORMAT_VERSION, **asdict(manifest)}
    for model in raw["models"]:
        if model["ordinary"] is not None:
            driving = model["ordinary"]["driving"]
            driving["whitening_ratio"] = _packed(driving["whitening_ratio"])
    text = json.dumps(raw, indent=1, sort_keys=True)
    return _NUMBERS.sub(lambda found: "[" + " ".join(found[1].split()) + "]", text) + "\n"


def manifest_from_json(text: str) -> BundleManifest:
    """Return the manifest that a JSON text holds.

    Raises:
        BundleError: The text is no manifest, or contradicts itself; the message says where.
        FeatureTableError: A model was made for a feature table that this software does not speak.
    """
    try:
        raw: dict[str, Any] = json.loads(text)
        if raw["format_version"] != FORMAT_VERSION:
            message = f"bundle format {raw['format_version']}, this software reads {FORMAT_VERSION}"
            raise BundleError(message)
        manifest = BundleManifest(
            name=str(raw["name"]),
            bundle_id=str(raw["bundle_id"]),
            models=tuple(_model_from(model) for model in raw["models"]),
            metrics={str(k): float(v) for k, v in raw["metrics"].items()},
            provenance={str(k): str(v) for k, v in raw["provenance"].items()},
            files_sha256={str(k): str(v) for k, v in raw["files_sha256"].items()},
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        message = f"not a bundle manifest: {type(error).__name__} at {error}"
        raise BundleError(message) from error
    check_manifest(manifest)
    return manifest


def _model_from(raw: dict[str, Any]) -> ModelManifest:
    golden, conformal = raw["golden"], raw["conformal"]
    errors, error_file = golden["expected_error_ratio"], raw["error_model_file"]
    section_id = raw["section_id"]
    return ModelManifest(
        table_digest=str(raw["table_digest"]),
        feature_names=tuple(str(n) for n in raw["feature_names"]),
        model_file=str(raw["model_file"]),
        error_model_file=None if error_file is None else str(error_file),
        mu_range=(float(raw["mu_range"][0]), float(raw["mu_range"][1])),
        envelope=_box_from(raw["envelope"]),
        golden=GoldenVectors(
            rows=tuple(_floats(row) for row in golden["rows"]),
            mu=_floats(golden["mu"]),
            expected_error_ratio=None if errors is None else _floats(errors),
        ),
        conformal=None
        if conformal is None
        else Conformal(
            coverage_frac=float(conformal["coverage_frac"]),
            quantile=float(conformal["quantile"]),
            doubtful_above_ratio=float(conformal["doubtful_above_ratio"]),
        ),
        ordinary=None if raw["ordinary"] is None else _ordinary_from(raw["ordinary"]),
        section_id=None if section_id is None else str(section_id),
        references=tuple(_reference_from(each) for each in raw["references"]),
    )


def _reference_from(raw: dict[str, Any]) -> TrainingReference:
    section_id = raw["section_id"]
    return TrainingReference(
        section_id=None if section_id is None else str(section_id),
        rows_count=int(raw["rows_count"]),
        quantiles=tuple(_floats(row) for row in raw["quantiles"]),
        mu_quantiles=_floats(raw["mu_quantiles"]),
    )


def _box_from(raw: dict[str, Any]) -> Envelope:
    return Envelope(
        lower=_floats(raw["lower"]),
        upper=_floats(raw["upper"]),
        outside_allowed_count=int(raw["outside_allowed_count"]),
    )


def _ordinary_from(raw: dict[str, Any]) -> OrdinaryDriving:
    driving = raw["driving"]
    return OrdinaryDriving(
        road_columns=tuple(str(name) for name in raw["road_columns"]),
        road=_box_from(raw["road"]),
        driving=DrivingEnvelope(
            columns=tuple(str(name) for name in driving["columns"]),
            lower=_floats(driving["lower"]),
            upper=_floats(driving["upper"]),
            cut_ratio=float(driving["cut_ratio"]),
            share_frac=_floats(driving["share_frac"]),
            middle_ratio=tuple(_floats(kind) for kind in driving["middle_ratio"]),
            whitening_ratio=_unpacked(driving["whitening_ratio"]),
            limit_level=float(driving["limit_level"]),
        ),
    )


def _packed(matrices: Sequence[Any]) -> dict[str, Any]:
    values = np.asarray(matrices, dtype=np.float64)
    short = values.astype("<f4")
    if not np.array_equal(short.astype(np.float64), values):
        message = "the whitening matrices hold numbers of more than 32 bits, which would be cut"
        raise BundleError(message)
    return {"shape": list(values.shape), _PACKED_KEY: base64.b64encode(short.tobytes()).decode()}


def _unpacked(raw: dict[str, Any]) -> FloatArray:
    kinds, rows, columns = (int(size) for size in raw["shape"])
    try:
        content = base64.b64decode(raw[_PACKED_KEY], validate=True)
    except binascii.Error as error:
        message = f"{_PACKED_KEY}: {error}"
        raise ValueError(message) from error
    return np.frombuffer(content, dtype="<f4").astype(np.float64).reshape(kinds, rows, columns)


def _floats(raw: Sequence[Any]) -> tuple[float, ...]:
    return tuple(float(value) for value in raw)
