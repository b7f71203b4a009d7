"""A bundle as a unit would use it: the same checks at the door, the same row, the same judgement, through ONNX."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roadgrip.bundle import (
    GOLDEN_TOLERANCE_MU,
    GOLDEN_TOLERANCE_RATIO,
    MANIFEST_NAME,
    BundleManifest,
    ModelManifest,
    check_files,
)
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError, ConfigurationError
from roadgrip.features import TABLES, FeatureTable, road_features, summary_among
from roadgrip.reasons import Reason
from roadgrip.records import PASSAGE_ID_BYTES, KinematicSummary, Passage, Rejected
from roadgrip.section import RoadSection
from roadgrip.units import FloatArray
from rsu_app.domain.judgement import Judgement, judgement
from rsu_app.domain.plausibility import implausibility, summary_values
from training.evaluation import Judge
from training.export import onnx_estimate_mu


@dataclass(frozen=True, slots=True)
class Bundle:
    """A bundle whose files are those its manifest names.

    Attributes:
        manifest: What it says about itself.
        files: Every other file's content by its name.
    """

    manifest: BundleManifest
    files: Mapping[str, bytes]


def read_bundle(folder: Path) -> Bundle:
    """Return the bundle of a folder after what a unit checks: every file is the one it names, golden vectors hold.

    Raises:
        BundleError: It must not be trusted; the message says why.
        FeatureTableError: It was made for a feature table that this software does not speak.
    """
    try:
        files = {
            path.name: path.read_bytes()
            for path in sorted(folder.iterdir())
            if path.is_file() and not path.name.startswith(".")
        }
        text = files.pop(MANIFEST_NAME).decode()
    except OSError as error:
        raise BundleError(f"cannot read {folder} as a bundle: {error.strerror or error}") from error
    except KeyError as error:
        raise BundleError(f"{folder} is no bundle: there is no {MANIFEST_NAME} in it") from error
    except UnicodeDecodeError as error:
        raise BundleError(f"{folder / MANIFEST_NAME} is no text") from error
    try:
        manifest = manifest_from_json(text)
        check_files(manifest, files)
        bundle = Bundle(manifest, files)
        for model in manifest.models:
            _check_golden(bundle, model)
    except BundleError as error:
        raise BundleError(f"{folder}: {error}") from error
    return bundle


def judge_of(bundle: Bundle) -> Judge:
    """Return what answers for summaries as a unit with this bundle does.

    A summary is told in the columns of the newest feature table that both it and the bundle have, as a vehicle does
    that was told which tables the unit serves.
    """

    def judge(asked: Sequence[tuple[KinematicSummary, RoadSection]]) -> list[Judgement | Rejected]:
        digests = bundle.manifest.table_digests
        offered = [(summary_among(summary, digests), section) for summary, section in asked]
        answers: list[Judgement | Rejected] = [_refusal(*each, digests) or _UNASKED for each in offered]
        for model in bundle.manifest.models:
            places = [
                i
                for i, (summary, section) in enumerate(offered)
                if answers[i] is _UNASKED
                and summary is not None
                and bundle.manifest.model_for(summary.table_digest, section_id=section.section_id) is model
            ]
            table = TABLES[model.table_digest]
            roads = {section: _road_row(section, table) for section in {offered[i][1] for i in places}}
            rows = [
                np.concatenate([summary_values(summary).astype(np.float64), roads[section]])
                for summary, section in (offered[i] for i in places)
                if summary is not None
            ]
            for i, answer in zip(places, _answers(bundle, model, np.array(rows)) if rows else [], strict=True):
                answers[i] = answer
        return answers

    return judge


_UNASKED = Rejected(Reason.NO_MODEL, "no model of the bundle was asked")


def _answers(bundle: Bundle, model: ModelManifest, rows: FloatArray) -> list[Judgement]:
    """Return what the models for one feature table say of rows of its features. (n, columns)"""
    mu, expected = _estimates(bundle, model, rows)
    return [
        judgement(row, model, mu=float(mu[i]), expected_error_ratio=None if expected is None else float(expected[i]))
        for i, row in enumerate(rows)
    ]


def _estimates(bundle: Bundle, model: ModelManifest, rows: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    mu, *errors = (onnx_estimate_mu(bundle.files[name], rows) for name in model.files)
    return mu, errors[0] if errors else None


def _refusal(summary: KinematicSummary | None, section: RoadSection, digests: Sequence[str]) -> Rejected | None:
    if summary is None:
        served = ", ".join(digests)
        return Rejected(Reason.WRONG_FEATURE_TABLE, f"the bundle serves {served}, which the summary does not cover")
    passage = Passage(
        passage_id=bytes(PASSAGE_ID_BYTES),
        section_id=section.section_id,
        map_version=section.version,
        summary=summary,
        age_s=0.0,
    )
    return implausibility(passage, section, table_digests=digests)


def _road_row(section: RoadSection, table: FeatureTable) -> FloatArray:
    row = road_features(section, table)
    for feature, value in zip(table.road, row, strict=True):
        if not feature.minimum <= value <= feature.maximum:
            raise ConfigurationError(f"section {section.section_id}: {feature.name} = {value:.6g} is out of range")
    return row


def _check_golden(bundle: Bundle, model: ModelManifest) -> None:
    golden = model.golden
    try:
        mu, expected = _estimates(bundle, model, np.array(golden.rows, dtype=np.float64))
    except Exception as error:  # the library's exceptions share no base class of their own
        raise BundleError(f"{' or '.join(model.files)} is no model: {error}") from error
    pairs = [("mu", mu, golden.mu, GOLDEN_TOLERANCE_MU)]
    if expected is not None and golden.expected_error_ratio is not None:
        pairs.append(("expected error", expected, golden.expected_error_ratio, GOLDEN_TOLERANCE_RATIO))
    for what, answers, wanted, tolerance in pairs:
        difference = float(np.abs(answers - np.array(wanted)).max())
        if not difference <= tolerance:
            raise BundleError(f"its {what} misses {len(golden.rows)} golden vectors by {difference:.2e}")
