"""Has the traffic of many units moved away from what their bundle was trained on, and is it time to train again?

Exported passages are held against the bundle's training reference, which is reported, and each section's against its
own first passages under this bundle, at like friction, which decides: see `rsu_app.domain.drift` and docs/drift.md.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import BundleManifest, ModelManifest
from roadgrip.errors import RoadgripError
from roadgrip.features import TABLES
from roadgrip.passage_export import ExportedPassage
from roadgrip.records import NotCounted
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.drift import BandReference, DriftAlarm, DriftPolicy, DriftReport, drift_report
from rsu_app.domain.section_baseline import SectionBaseline
from training.data.exported_passages import Export

DAY_S = 86_400.0
LASTING_PERIODS_COUNT = 2
"""An alarm of a section lasts when so many periods of its own in a row have it, the latest among them."""
COMMON_SHARE = 0.5
"""An alarm is common when this share of the judged sections, and two at least, have it in the latest period."""


class DriftError(RoadgripError):
    """Exports that say nothing about drift; the message says why."""


class Advice(StrEnum):
    """What to do about a bundle."""

    KEEP = "keep"
    WATCH = "watch"
    RETRAIN = "retrain"


@dataclass(frozen=True, slots=True)
class ShadowDifference:
    """How far shadow models (challengers) are from the live one (the champion), on the same passages.

    Attributes:
        passages_count: Passages for which both named a friction.
        median_ratio: Median of ln(shadow / live).
        spread_ratio: What nine in ten of its magnitudes stay below.
    """

    passages_count: int
    median_ratio: float
    spread_ratio: float


@dataclass(frozen=True, slots=True)
class Period:
    """What a section's passages of one period say.

    Attributes:
        from_unix_s: Its start.
        report: What drifted. Passages that the baseline was learned from are not held against it.
        median_mu: Median of the estimates; None without any.
        shadow: How far shadows are from the live model; None without one.
    """

    from_unix_s: float
    report: DriftReport
    median_mu: float | None
    shadow: ShadowDifference | None


@dataclass(frozen=True, slots=True)
class SectionDrift:
    """What the passages of one section at one unit say, in one feature table.

    Attributes:
        unit: Name of the unit.
        section_id: Of the section.
        table_version: Of the feature table.
        passages_count: All passages.
        not_counted: Why passages did not count, and how many.
        baseline_count: Passages that its bands of like friction were learned from; 0 before there is one.
        periods: Those with passages, oldest first.
    """

    unit: str
    section_id: str
    table_version: int
    passages_count: int
    not_counted: Mapping[str, int]
    baseline_count: int
    periods: tuple[Period, ...]

    def lasting(self, alarm: DriftAlarm) -> bool:
        """Return whether the latest periods of the section all have an alarm."""
        latest = self.periods[-LASTING_PERIODS_COUNT:]
        return len(latest) == LASTING_PERIODS_COUNT and all(alarm in each.report.alarms for each in latest)


@dataclass(frozen=True, slots=True)
class Drift:
    """What exports say about drift under one bundle.

    Attributes:
        bundle_id: The bundle.
        from_unix_s: First passage.
        until_unix_s: Last passage.
        period_s: Length of a period; the last one ends with the last passage.
        left_out: Passages that are not judged: why, and how many.
        sections: By unit, section and table.
        pooled: All units and sections of the latest period against the training on all roads, by table version.
        advice: What to do.
        reasons: Why, in sentences.
    """

    bundle_id: str
    from_unix_s: float
    until_unix_s: float
    period_s: float
    left_out: Mapping[str, int]
    sections: tuple[SectionDrift, ...]
    pooled: Mapping[int, DriftReport]
    advice: Advice
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Traffic:
    """Passages of one section at one unit, or of all together, in the order of time. All arrays (n,) but values."""

    left_unix_s: FloatArray
    values: NDArray[np.float32]
    mu: FloatArray
    flags: NDArray[np.int64]
    shadow_mu: FloatArray

    def where(self, kept: BoolArray) -> _Traffic:
        return _Traffic(
            self.left_unix_s[kept], self.values[kept], self.mu[kept], self.flags[kept], self.shadow_mu[kept]
        )

    @property
    def out_of_envelope_count(self) -> int:
        return int(((self.flags & NotCounted.OUT_OF_ENVELOPE.value) != 0).sum())


@dataclass(frozen=True, slots=True)
class _Terms:
    until_unix_s: float
    period_s: float
    policy: DriftPolicy

    @property
    def latest_from_unix_s(self) -> float:
        return self.until_unix_s - self.period_s


@dataclass(frozen=True, slots=True, eq=False)
class _Learned:
    """The bands of a section's own traffic, and which of its passages were taken for one, learned or not. (n,)"""

    bands: tuple[BandReference, ...]
    taken: BoolArray


def drift_of(
    exports: Sequence[Export],
    manifest: BundleManifest,
    *,
    period_s: float = 7.0 * DAY_S,
    policy: DriftPolicy | None = None,
    on_section: Callable[[int, int], None] | None = None,
) -> Drift:
    """Return what exports say about drift under a bundle.

    Args:
        exports: Of any number of units; a passage that two of them hold counts once.
        manifest: The bundle whose estimates are judged; passages that another one judged are left out.
        period_s: How long traffic is gathered before it is judged.
        policy: Limits.
        on_section: Called after each section with how many are done, and of how many.

    Raises:
        DriftError: The exports hold no passage that this bundle judged.
    """
    policy = policy or DriftPolicy()
    groups, left_out = _grouped(exports, manifest)
    if not groups:
        counts = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in left_out.items()) or "no passage at all"
        raise DriftError(f"the exports hold no passage that bundle {manifest.bundle_id} judged: {counts}")
    traffics = {key: _traffic(passages) for key, passages in sorted(groups.items())}
    until_unix_s = max(float(traffic.left_unix_s[-1]) for traffic in traffics.values())
    terms = _Terms(until_unix_s, period_s, policy)
    sections = []
    for number, ((unit, section_id, digest), traffic) in enumerate(traffics.items(), start=1):
        model = _model_of(manifest, digest, section_id)
        sections.append(_section_drift(unit, section_id, model, traffic, terms=terms))
        if on_section is not None:
            on_section(number, len(traffics))
    advice, reasons = advice_of(sections, latest_from_unix_s=terms.latest_from_unix_s, policy=policy)
    return Drift(
        bundle_id=manifest.bundle_id,
        from_unix_s=min(float(traffic.left_unix_s[0]) for traffic in traffics.values()),
        until_unix_s=until_unix_s,
        period_s=period_s,
        left_out=left_out,
        sections=tuple(sections),
        pooled=_pooled(traffics, manifest, terms),
        advice=advice,
        reasons=(*_remarks(manifest), *reasons),
    )


def advice_of(
    sections: Sequence[SectionDrift], *, latest_from_unix_s: float, policy: DriftPolicy
) -> tuple[Advice, list[str]]:
    """Return what to do, and why: train again when an alarm lasts at a section, or is common to many of them.

    Args:
        sections: What each section's passages say.
        latest_from_unix_s: From then on the latest period.
        policy: Limits, for the words.
    """
    present = [each for each in sections if each.periods[-1].from_unix_s >= latest_from_unix_s]
    judged = [each for each in present if each.periods[-1].report.total_count >= policy.rows_least_count]
    if not judged:
        least = policy.rows_least_count
        return Advice.WATCH, [f"No section had {least} passages in the latest period: nothing can be judged."]
    advices, reasons = {Advice.KEEP}, []
    for alarm in DriftAlarm:
        raised = [each for each in judged if alarm in each.periods[-1].report.alarms]
        lasting = [each for each in raised if each.lasting(alarm)]
        common = len(raised) >= max(2.0, COMMON_SHARE * len(judged))
        if not raised:
            continue
        advices.add(Advice.RETRAIN if lasting or common else Advice.WATCH)
        how = "for several periods at" if lasting else "in the latest period at"
        places = _places(lasting or raised, len(judged))
        reasons.append(
            f"{_SENTENCES[alarm]} {how} {places}{_moved(raised) if alarm is DriftAlarm.OWN_TRAFFIC else ''}."
        )
    if not reasons:
        reasons.append(f"None of {len(judged)} sections with enough passages has drifted in the latest period.")
    unlearned = [each for each in judged if not each.periods[-1].report.own_features]
    if unlearned:
        reasons.append(
            f"{len(unlearned)} of them could not be held against earlier traffic at like friction: too few passages."
        )
    order = (Advice.KEEP, Advice.WATCH, Advice.RETRAIN)
    return max(advices, key=order.index), reasons


def moved_most(sections: Iterable[SectionDrift]) -> list[tuple[str, int]]:
    """Return the features that drifted against a section's own traffic in its latest period, and at how many sections.

    Those of most sections come first.
    """
    counted = Counter(
        feature.name for each in sections for feature in each.periods[-1].report.own_features if feature.drifted
    )
    return sorted(counted.items(), key=lambda each: (-each[1], each[0]))


_SENTENCES = {
    DriftAlarm.OUT_OF_ENVELOPE: "Too many passages lie outside the model's envelope",
    DriftAlarm.OWN_TRAFFIC: "Traffic is not what it was at like friction",
    DriftAlarm.ESTIMATES_OUTSIDE: "Estimates lie beyond those of the training",
}
_NAMED_COUNT = 5


def _places(sections: Sequence[SectionDrift], judged_count: int) -> str:
    named = ", ".join(f"{each.section_id} ({each.unit})" for each in sections[:_NAMED_COUNT])
    more = f" and {len(sections) - _NAMED_COUNT} more" if len(sections) > _NAMED_COUNT else ""
    return f"{len(sections)} of {judged_count} sections: {named}{more}"


def _moved(sections: Sequence[SectionDrift]) -> str:
    return f"; most moved {', '.join(name for name, _ in moved_most(sections)[:_NAMED_COUNT])}"


def _remarks(manifest: BundleManifest) -> list[str]:
    if any(model.references for model in manifest.models):
        return []
    return ["The bundle holds no training reference: features and estimates are not held against the training."]


def _model_of(manifest: BundleManifest, digest: str, section_id: str) -> ModelManifest:
    model = manifest.model_for(digest, section_id=section_id)
    if model is None:
        raise DriftError(f"bundle {manifest.bundle_id} has no model for feature table {digest}")
    return model


def _grouped(
    exports: Sequence[Export], manifest: BundleManifest
) -> tuple[dict[tuple[str, str, str], list[ExportedPassage]], dict[str, int]]:
    """Return the passages of each unit, section and feature table, and why others are left out."""
    groups: dict[tuple[str, str, str], list[ExportedPassage]] = defaultdict(list)
    left_out: Counter[str] = Counter()
    seen: set[tuple[str, str, float, bytes]] = set()
    for export in exports:
        left_out["unreadable"] += len(export.refused)
        for passage in export.passages.values():
            identity = (export.head.unit, passage.section_id, passage.left_unix_s, passage.values.tobytes())
            why = _unfit(passage, manifest) or ("repeated" if identity in seen else None)
            if why is not None:
                left_out[why] += 1
                continue
            seen.add(identity)
            groups[export.head.unit, passage.section_id, passage.table_digest].append(passage)
    return groups, {why: count for why, count in sorted(left_out.items()) if count}


def _unfit(passage: ExportedPassage, manifest: BundleManifest) -> str | None:
    if passage.bundle_id != manifest.bundle_id:
        return "judged_by_another_bundle"
    if passage.table_digest not in manifest.table_digests:
        return "of_another_feature_table"
    width = len(TABLES[passage.table_digest].kinematic)
    return None if len(passage.values) == width else "of_a_wrong_width"


def _traffic(passages: Sequence[ExportedPassage]) -> _Traffic:
    # Equal moments, of which an export has many, are told apart by content: the order of the files does not matter.
    ordered = sorted(passages, key=lambda each: (each.left_unix_s, each.values.tobytes()))

    def numbers(values: Iterable[float | None]) -> FloatArray:
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)

    return _Traffic(
        left_unix_s=numbers(each.left_unix_s for each in ordered),
        values=np.array([each.values for each in ordered], dtype=np.float32),
        mu=numbers(each.mu for each in ordered),
        flags=np.array([each.flags for each in ordered], dtype=np.int64),
        shadow_mu=numbers(each.shadow_mu for each in ordered),
    )


def _section_drift(
    unit: str, section_id: str, model: ModelManifest, traffic: _Traffic, *, terms: _Terms
) -> SectionDrift:
    learned = _baseline(traffic)
    ago_count = np.floor((terms.until_unix_s - traffic.left_unix_s) / terms.period_s)
    periods = []
    for ago in sorted(set(ago_count.tolist()), reverse=True):
        inside = ago_count == ago
        part = traffic.where(inside)
        fresh = traffic.where(inside & ~learned.taken)
        periods.append(
            Period(
                from_unix_s=terms.until_unix_s - (ago + 1.0) * terms.period_s,
                report=drift_report(
                    model.reference_for(section_id),
                    _kinematic_names(model.table_digest),
                    fresh.values.astype(np.float64),
                    fresh.mu,
                    out_of_envelope_count=part.out_of_envelope_count,
                    total_count=len(part.mu),
                    baseline=learned.bands,
                    policy=terms.policy,
                ),
                median_mu=_median(part.mu),
                shadow=_shadow_difference(part),
            )
        )
    words = {flag: int(((traffic.flags & flag.value) != 0).sum()) for flag in NotCounted if flag.value}
    return SectionDrift(
        unit=unit,
        section_id=section_id,
        table_version=TABLES[model.table_digest].version,
        passages_count=len(traffic.mu),
        not_counted={(flag.name or "").lower(): count for flag, count in words.items() if count},
        baseline_count=sum(band.rows_count for band in learned.bands),
        periods=tuple(periods),
    )


def _baseline(traffic: _Traffic) -> _Learned:
    """Return what a section's first counted passages taught."""
    baseline = SectionBaseline()
    taken = np.zeros(len(traffic.mu), dtype=np.bool_)
    usable = (traffic.flags == 0) & np.isfinite(traffic.values).all(axis=1) & (traffic.mu > 0.0)
    for place in np.flatnonzero(usable).tolist():
        taken[place] = baseline.add(
            left_at_s=float(traffic.left_unix_s[place]), values=traffic.values[place], mu=float(traffic.mu[place])
        )
    return _Learned(baseline.bands, taken)


def _kinematic_names(table_digest: str) -> list[str]:
    return [feature.name for feature in TABLES[table_digest].kinematic]


def _pooled(
    traffics: Mapping[tuple[str, str, str], _Traffic], manifest: BundleManifest, terms: _Terms
) -> dict[int, DriftReport]:
    """Return what the latest period of all sections together says, by table version."""
    pooled = {}
    for digest in manifest.table_digests:
        latest = [
            traffic.where(traffic.left_unix_s > terms.latest_from_unix_s)
            for (_, _, table_digest), traffic in traffics.items()
            if table_digest == digest
        ]
        model = manifest.model_for(digest)
        if model is None or not any(len(each.mu) for each in latest):
            continue
        everywhere = next((known for known in model.references if known.section_id is None), None)
        pooled[TABLES[digest].version] = drift_report(
            everywhere,
            _kinematic_names(digest),
            np.concatenate([each.values for each in latest]).astype(np.float64),
            np.concatenate([each.mu for each in latest]),
            out_of_envelope_count=sum(each.out_of_envelope_count for each in latest),
            total_count=sum(len(each.mu) for each in latest),
            policy=terms.policy,
        )
    return pooled


def _median(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None


def _shadow_difference(traffic: _Traffic) -> ShadowDifference | None:
    both = (traffic.mu > 0.0) & (traffic.shadow_mu > 0.0)
    if not both.any():
        return None
    differences = np.log(traffic.shadow_mu[both] / traffic.mu[both])
    return ShadowDifference(
        passages_count=int(both.sum()),
        median_ratio=float(np.median(differences)),
        spread_ratio=float(np.quantile(np.abs(differences), 0.9)),
    )
