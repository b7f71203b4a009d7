"""What is written of drift: a document for machines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import isnan
from typing import Any

from rsu_app.domain.drift import DriftReport, FeatureDrift, worst
from training.drift.drift import Drift, Period, SectionDrift, moved_most
from training.rounding import rounded

WORST_COUNT = 10
"""So many features of a comparison are named, those that moved most."""
_DIGITS_COUNT = 4


def document_of(drift: Drift) -> dict[str, Any]:
    """Return what exports say about drift, as JSON holds it; figures with four digits, times with all."""
    return {
        "bundle_id": drift.bundle_id,
        "advice": drift.advice.value,
        "reasons": list(drift.reasons),
        "from_unix_s": drift.from_unix_s,
        "until_unix_s": drift.until_unix_s,
        "period_s": drift.period_s,
        "left_out": dict(drift.left_out),
        "moved_most": [{"name": name, "sections_count": count} for name, count in moved_most(drift.sections)],
        "pooled": [{"table_version": version, **_report(report)} for version, report in drift.pooled.items()],
        "sections": [_section(each) for each in drift.sections],
    }


def _section(section: SectionDrift) -> dict[str, Any]:
    return {
        "unit": section.unit,
        "section_id": section.section_id,
        "table_version": section.table_version,
        "passages_count": section.passages_count,
        "not_counted": dict(section.not_counted),
        "baseline_count": section.baseline_count,
        "periods": [_period(each) for each in section.periods],
    }


def _period(period: Period) -> dict[str, Any]:
    return {
        "from_unix_s": period.from_unix_s,
        "median_mu": rounded(period.median_mu, digits_count=_DIGITS_COUNT),
        "shadow": None if period.shadow is None else rounded(asdict(period.shadow), digits_count=_DIGITS_COUNT),
        **_report(period.report),
    }


def _report(report: DriftReport) -> dict[str, Any]:
    return rounded(
        {
            "passages_count": report.total_count,
            "compared_count": report.rows_count,
            "not_finite_count": report.not_finite_count,
            "out_of_envelope_frac": report.out_of_envelope_frac,
            "estimates_outside_frac": report.estimates_outside_frac,
            "alarms": [alarm.value for alarm in report.alarms],
            "own_traffic": _comparison(report.own_features, report.own_rows_count),
            "training": {
                "own_road": report.own_road,
                "estimate": None if report.estimate is None else _feature(report.estimate),
                **_comparison(report.features, report.rows_count),
            },
        },
        digits_count=_DIGITS_COUNT,
    )


def _comparison(features: Sequence[FeatureDrift], rows_count: int) -> dict[str, Any]:
    """Return what a comparison says; the counts are None when there were too few passages for it."""
    return {
        "rows_count": rows_count,
        "features_count": len(features) or None,
        "drifted_count": sum(feature.drifted for feature in features) if features else None,
        "worst": [_feature(feature) for feature in worst(features, WORST_COUNT)],
    }


def _feature(feature: FeatureDrift) -> dict[str, Any]:
    return {
        "name": feature.name,
        "psi_ratio": None if isnan(feature.psi_ratio) else feature.psi_ratio,
        "ks_frac": None if isnan(feature.ks_frac) else feature.ks_frac,
        "drifted": feature.drifted,
    }
