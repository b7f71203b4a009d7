"""An evaluation as JSON, CSV, and one page with pictures."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from enum import IntFlag
from typing import Any

from roadgrip.bundle import BundleManifest
from roadgrip.section import RoadSection
from training.evaluation import Evaluation
from training.evaluation_figures import ErrorFigures, EvaluatedPassage, SectionInterval
from vehicle_client.vehicle_profile import VehicleProfile

PASSAGE_COLUMNS = (
    "file",
    "section",
    "group",
    "ending",
    "reason",
    "detail",
    "quality",
    "not_counted",
    "label_mu",
    "estimate_mu",
    "error_ratio",
    "expected_error_ratio",
    "at_least_mu",
    "recorded_hz",
    "entry_s",
    "exit_s",
    "mean_speed_mps",
    "matched_by",
)
"""What is told of every drive, in `passages.csv` and in the JSON document; docs/evaluate.md says what each means."""


def words_of(flags: IntFlag) -> list[str]:
    """Return the names of the flags that are set, as the wire's documentation spells them."""
    return [(flag.name or "").lower() for flag in type(flags) if flag & flags]


def passage_cells(passage: EvaluatedPassage) -> dict[str, Any]:
    """Return one drive's row by `PASSAGE_COLUMNS`; None where there is nothing to tell."""
    told: dict[str, Any] = {
        "file": passage.name,
        "section": passage.section_id,
        "group": passage.group,
        "ending": passage.ending.value,
        "reason": passage.reason,
        "detail": passage.detail,
        "quality": words_of(passage.quality),
        "not_counted": words_of(passage.flags),
        "label_mu": passage.label_mu,
        "estimate_mu": passage.estimate_mu,
        "error_ratio": passage.error_ratio,
        "expected_error_ratio": passage.expected_error_ratio,
        "at_least_mu": passage.at_least_mu,
        "recorded_hz": round(1.0 / passage.step_s, 2),
        "entry_s": passage.entry_s,
        "exit_s": passage.exit_s,
        "mean_speed_mps": passage.mean_speed_mps,
        "matched_by": passage.matched_by,
    }
    return {name: _or_none(told[name]) for name in PASSAGE_COLUMNS}


def document_of(
    evaluation: Evaluation,
    *,
    bundle: BundleManifest,
    sections: Sequence[RoadSection],
    vehicle: VehicleProfile,
) -> dict[str, Any]:
    """Return an evaluation as a JSON document; nothing in it is NaN.

    Args:
        evaluation: What came out.
        bundle: What was evaluated.
        sections: The maps, in the order in which they were tried.
        vehicle: The car, where a drive did not name its own.
    """
    return {
        "bundle": {"name": bundle.name, "bundle_id": bundle.bundle_id, "table_digests": list(bundle.table_digests)},
        "vehicle": vehicle.name,
        "sections": [
            {"section_id": each.section_id, "version": each.version, "length_m": each.length_m} for each in sections
        ],
        "endings": _counts(evaluation),
        "refusals": dict(evaluation.refusals),
        "errors": _figures(evaluation.errors),
        "errors_by_section": _figures(evaluation.errors_by_section),
        "errors_by_friction": _figures(evaluation.errors_by_friction),
        "intervals": [_interval(each) for each in evaluation.intervals],
        "passages": [passage_cells(each) for each in evaluation.passages],
    }


def csv_of(passages: Sequence[EvaluatedPassage]) -> str:
    """Return one row per drive with a header; lists of words are joined by spaces, what is unknown is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, PASSAGE_COLUMNS, lineterminator="\n")
    writer.writeheader()
    for passage in passages:
        cells = passage_cells(passage)
        writer.writerow({name: " ".join(cell) if isinstance(cell, list) else cell for name, cell in cells.items()})
    return text.getvalue()


def _counts(evaluation: Evaluation) -> dict[str, int]:
    endings = [passage.ending.value for passage in evaluation.passages]
    return {ending: endings.count(ending) for ending in dict.fromkeys(endings)}


def _figures(errors: Mapping[str, ErrorFigures]) -> dict[str, dict[str, Any]]:
    return {name: {key: _or_none(value) for key, value in asdict(each).items()} for name, each in errors.items()}


def _interval(each: SectionInterval) -> dict[str, Any]:
    return {
        "section": each.section_id,
        "group": each.group,
        "interval": {**asdict(each.interval), "confidence": each.interval.confidence.value},
        "label_low_mu": each.label_low_mu,
        "label_high_mu": each.label_high_mu,
        "midpoint_error_ratio": each.midpoint_error_ratio,
        "labels_inside_frac": each.labels_inside_frac,
    }


def _or_none(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
