"""What goes over HTTP as JSON: SI units in every name, and the way to and from the records.

The models only say what JSON is; whether a passage is plausible is decided where frames are judged too.
"""

from __future__ import annotations

from math import isfinite
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import (
    PASSAGE_ID_BYTES,
    Accepted,
    AdvisoryNotice,
    AdvisoryReason,
    Confidence,
    KinematicSummary,
    NotCounted,
    Passage,
    QualityFlag,
)
from roadgrip.section import BankOrigin, Direction, RoadSection
from rsu_app.domain.pooling import RefinedInterval
from rsu_app.usecases import SectionFriction

HexId = Annotated[
    str,
    Field(
        pattern=r"^[0-9a-f]{32}$",
        description="16 random bytes in lower-case hexadecimal, new for every passage; twice the same changes nothing.",
    ),
]

Number = Annotated[float, Field(strict=True)]
"""A number as a number: what a vehicle measured is never the text "1.5" or the truth value of something."""


class _Model(BaseModel):
    # NaN reaches the plausibility check, which refuses it as `not_finite` and not as bad JSON.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=True)


_REFINED_EXAMPLE: dict[str, JsonValue] = {
    "mu_low": 0.284,
    "mu_new": 0.355,
    "half_width_mu": 0.031,
    "informative_count": 49,
    "censored_count": 8,
    "clipped": False,
    "at_least": False,
}
_INTERVAL_EXAMPLE: dict[str, JsonValue] = {
    "mu_low": 0.28,
    "mu_new": 0.35,
    "median_mu": 0.315,
    "median_low_mu": 0.306,
    "median_high_mu": 0.323,
    "coverage_frac": 0.967,
    "passages_count": 57,
    "confidence": "recommended",
    "newest_age_s": 41.5,
    "valid_for_s": 300.0,
    "at_least": False,
    "since_change_s": 1250.0,
    "refined": _REFINED_EXAMPLE,
}


def _with_example(example: dict[str, JsonValue]) -> ConfigDict:
    """Return the configuration of a model that shows what it looks like; a test reads each example back."""
    return ConfigDict(frozen=True, extra="forbid", allow_inf_nan=True, json_schema_extra={"examples": [example]})


class AnchorModel(_Model):
    """A point of the centre line in geographic coordinates (WGS 84)."""

    station_m: float
    lat_deg: float
    lon_deg: float


class SectionModel(_Model):
    """A section the unit serves."""

    section_id: str = Field(examples=["long-turn"])
    name: str
    direction: Direction
    map_version: str = Field(description="Digest of the map; a passage names the map it was cut with.")
    table_digests: tuple[str, ...] = Field(description="Feature tables the unit accepts summaries for.")
    length_m: float
    tightest_radius_m: float
    speed_limit_mps: float
    bank_origin: BankOrigin
    anchors: tuple[AnchorModel, ...] = Field(description="Empty when the map has no geographic reference.")
    links: dict[str, str] = Field(description="Where to go from here.")


class SectionsModel(_Model):
    """The sections a unit serves."""

    sections: tuple[SectionModel, ...]


class RefinedModel(_Model):
    """A second opinion beside the published interval: each estimate by its expected error, bounds as bounds."""

    model_config = _with_example(_REFINED_EXAMPLE)

    mu_low: float = Field(description="Lower end, 0.8 mu_new.")
    mu_new: float = Field(description="What a new tyre finds; within 2 % of what the median places.")
    half_width_mu: float | None = Field(
        description="mu_new lies this near with 95 %, an error that all vehicles share included; "
        "null while nothing bounds the friction from above."
    )
    informative_count: int = Field(description="Vehicles that name a friction, among the newest thousand that count.")
    censored_count: int = Field(description="Vehicles of those that only say that it is at least so much.")
    clipped: bool = Field(
        description="The median held it back; often so means liars, or vehicles whose errors are not as expected."
    )
    at_least: bool = Field(description="So few name a friction that mu_low and mu_new are lower bounds.")


class IntervalModel(_Model):
    """The friction that tyres from worn to new find on a section, from the median of the last hour."""

    model_config = _with_example(_INTERVAL_EXAMPLE)

    mu_low: float = Field(description="Lower end, 0.8 mu_new.")
    mu_new: float = Field(description="What a new tyre finds.")
    median_mu: float
    median_low_mu: float = Field(description="Lower end of the confidence interval of the median.")
    median_high_mu: float
    coverage_frac: float = Field(description="Probability with which that interval covers the true median.")
    passages_count: int
    confidence: Confidence
    newest_age_s: float
    valid_for_s: float
    at_least: bool = Field(
        description="So few vehicles name a friction that the interval is not much more than a lower bound."
    )
    since_change_s: float | None = Field(
        description="Only vehicles since a change of the friction count, the first of them so long ago; null without."
    )
    refined: RefinedModel


class FrictionModel(_Model):
    """The friction of a section; `interval` is null while there is nothing to publish, and `confidence` says why."""

    model_config = _with_example(
        {
            "section_id": "long-turn",
            "map_version": "0123456789abcdef",
            "confidence": "recommended",
            "interval": _INTERVAL_EXAMPLE,
        }
    )

    section_id: str
    map_version: str
    confidence: Confidence
    interval: IntervalModel | None


class AdvisoryModel(_Model):
    """What drivers are told."""

    model_config = _with_example(
        {
            "section_id": "long-turn",
            "map_version": "0123456789abcdef",
            "speed_mps": 11.11,
            "reason": "friction_interval",
            "confidence": "recommended",
            "valid_for_s": 300.0,
            "issued_unix_s": 1_770_000_000,
            "interval": _INTERVAL_EXAMPLE,
        }
    )

    section_id: str
    map_version: str
    speed_mps: float = Field(description="A multiple of 5 km/h.")
    reason: AdvisoryReason
    confidence: Confidence
    valid_for_s: float
    issued_unix_s: int = Field(description="The unit's wall clock, or 0 when it cannot be trusted.")
    interval: IntervalModel | None


class PassageModel(_Model):
    """One vehicle's pass over the section: the JSON form of the message SUMMARY."""

    model_config = _with_example(
        {
            "passage_id": "00112233445566778899aabbccddeeff",
            "map_version": "0123456789abcdef",
            "table_digest": NEWEST_TABLE.digest,
            "duration_s": 27.4,
            "age_s": 1.2,
            "quality": 0,
            "values": [0.0] * len(NEWEST_TABLE.kinematic),
        }
    )

    passage_id: HexId
    map_version: str = Field(max_length=64, description="Version of the map the summary was cut with.")
    table_digest: str = Field(max_length=64, description="Feature table the values were made for.")
    duration_s: Number = Field(description="Time spent inside the section.")
    age_s: Number = Field(description="Time since the vehicle left the section, by its own monotonic clock.")
    quality: int = Field(
        default=0, strict=True, ge=0, le=int(sum(QualityFlag)), description="Flags the vehicle sets about its summary."
    )
    values: tuple[Number, ...] = Field(
        max_length=256, description="The kinematic features in the order of the table that the digest names."
    )

    def to_record(self, section_id: str) -> Passage:
        """Return the record."""
        return Passage(
            passage_id=bytes.fromhex(self.passage_id),
            section_id=section_id,
            map_version=self.map_version,
            summary=KinematicSummary(
                values=self.values,
                table_digest=self.table_digest,
                duration_s=self.duration_s,
                quality=QualityFlag(self.quality),
            ),
            age_s=self.age_s,
        )


class ReceiptModel(_Model):
    """The passage is stored. It never holds the estimate, which would train liars."""

    model_config = _with_example(
        {
            "passage_id": "00112233445566778899aabbccddeeff",
            "outcome": "accepted",
            "counted": False,
            "not_counted": ["out_of_envelope"],
        }
    )

    passage_id: HexId
    outcome: str = "accepted"
    counted: bool = Field(description="Whether it enters the window.")
    not_counted: tuple[str, ...] = Field(description="Why it does not.")


class DetectionModel(_Model):
    """A loop or a camera reports a vehicle at the entry of the section."""

    model_config = _with_example({"source": "loop-1"})

    source: str = Field(default="", max_length=48, description="Name of the detector, for the log.")


class BroadcastModel(_Model):
    """What a detection set in motion."""

    frames_sent_count: int
    bytes_sent_count: int


class ConditionModel(_Model):
    """One condition of readiness."""

    name: str = Field(examples=["model"])
    ok: bool
    required: bool = Field(description="Whether the unit is unready without it; the others are for information.")
    detail: str


class ReadinessModel(_Model):
    """Whether the unit does its job, and if not why."""

    model_config = _with_example(
        {
            "ready": False,
            "conditions": [
                {"name": "model", "ok": True, "required": True, "detail": "bundle 3f2a answers its golden vectors"},
                {"name": "store", "ok": False, "required": True, "detail": "writing: the disk is full"},
            ],
        }
    )

    ready: bool
    conditions: tuple[ConditionModel, ...]


class LivenessModel(_Model):
    """The process answers."""

    live: bool = True
    version: str


def section_model(section: RoadSection, table_digests: tuple[str, ...]) -> SectionModel:
    """Return the section as the listing shows it."""
    here = f"/v1/sections/{section.section_id}"
    return SectionModel(
        section_id=section.section_id,
        name=section.name,
        direction=section.direction,
        map_version=section.version,
        table_digests=table_digests,
        length_m=round(section.length_m, 3),
        tightest_radius_m=round(section.tightest_radius_m, 3),
        speed_limit_mps=section.speed_limit_mps,
        bank_origin=section.bank_origin,
        anchors=tuple(
            AnchorModel(station_m=a.station_m, lat_deg=a.lat_deg, lon_deg=a.lon_deg) for a in section.anchors
        ),
        links={name: f"{here}/{name}" for name in ("map", "advisory", "friction", "passages")},
    )


def refined_model(refined: RefinedInterval) -> RefinedModel:
    """Return the second opinion as JSON shows it."""
    return RefinedModel(
        mu_low=refined.mu_low,
        mu_new=refined.mu_new,
        half_width_mu=refined.half_width_mu if isfinite(refined.half_width_mu) else None,
        informative_count=refined.informative_count,
        censored_count=refined.censored_count,
        clipped=refined.clipped,
        at_least=refined.at_least,
    )


def interval_model(friction: SectionFriction | None) -> IntervalModel | None:
    """Return the interval and what stands beside it as JSON shows it."""
    if friction is None:
        return None
    interval = friction.interval
    return IntervalModel(
        mu_low=interval.mu_low,
        mu_new=interval.mu_new,
        median_mu=interval.median_mu,
        median_low_mu=interval.median_low_mu,
        median_high_mu=interval.median_high_mu,
        coverage_frac=interval.coverage_frac,
        passages_count=interval.passages_count,
        confidence=interval.confidence,
        newest_age_s=interval.newest_age_s,
        valid_for_s=interval.valid_for_s,
        at_least=friction.at_least,
        since_change_s=friction.since_change_s,
        refined=refined_model(friction.refined),
    )


def advisory_model(section: RoadSection, notice: AdvisoryNotice, friction: SectionFriction | None) -> AdvisoryModel:
    """Return the advisory as JSON shows it, with the friction behind it."""
    advisory = notice.advisory
    return AdvisoryModel(
        section_id=section.section_id,
        map_version=section.version,
        speed_mps=advisory.speed_mps,
        reason=advisory.reason,
        confidence=advisory.confidence,
        valid_for_s=advisory.valid_for_s,
        issued_unix_s=notice.issued_unix_s,
        interval=interval_model(friction),
    )


def receipt_model(passage_id: bytes, outcome: Accepted) -> ReceiptModel:
    """Return the receipt of an accepted passage."""
    flags = tuple((flag.name or "").lower() for flag in NotCounted if flag and flag in outcome.flags)
    return ReceiptModel(passage_id=passage_id.hex(), counted=outcome.counted, not_counted=flags)


assert PASSAGE_ID_BYTES * 2 == 32, "HexId spells the length of a passage id"  # noqa: S101 - checked when imported
