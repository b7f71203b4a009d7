"""The frozen records that the packages hand to each other, and the codes they speak.

`Arrival`, `Cookie`, `MapOffer`, `AdvisoryNotice`, `Passage`, `Receipt` and `Beacon` are what goes over the air
(`roadgrip.wire` turns them into bytes and back); the rest stays inside one machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag, StrEnum
from typing import TYPE_CHECKING, TypeAlias

from roadgrip.reasons import Reason

if TYPE_CHECKING:
    from roadgrip.section import RoadSection

__all__ = [
    "PASSAGE_ID_BYTES",
    "RSU_FRAME_BUDGET",
    "VEHICLE_FRAME_BUDGET",
    "Accepted",
    "Advisory",
    "AdvisoryNotice",
    "AdvisoryReason",
    "Arrival",
    "Beacon",
    "Confidence",
    "Cookie",
    "FrictionInterval",
    "KinematicSummary",
    "MapOffer",
    "Message",
    "NotCounted",
    "Outcome",
    "Passage",
    "QualityFlag",
    "Reason",
    "Receipt",
    "Rejected",
]


class QualityFlag(IntFlag):
    """What the vehicle says about its own summary."""

    NONE = 0
    STABILITY_ACTIVE = 1
    NO_GNSS = 2
    OFFSETS_UNCERTAIN = 4
    SAMPLES_MISSING = 8
    REFERENCE_SPEED = 16
    """The speed came from a reference instrument, not from wheel encoders (recorded drives)."""
    GNSS_POOR = 32
    """Position fixes were there, yet too few or too bad along the section: dead reckoning bridged them."""
    SENSORS_DOUBTFUL = 64
    """Two sensors tell of different motions, by less than what keeps the passage back."""


class NotCounted(IntFlag):
    """Why an accepted passage does not enter the window."""

    NONE = 0
    OUT_OF_ENVELOPE = 1
    OLDER_THAN_WINDOW = 2
    ESTIMATE_OUT_OF_RANGE = 4


class Confidence(StrEnum):
    """How far the interval of a section may be trusted, by the number of vehicles behind it."""

    INSUFFICIENT = "insufficient"
    PROVISIONAL = "provisional"
    RECOMMENDED = "recommended"


class AdvisoryReason(StrEnum):
    """Which rule gave the advised speed."""

    FRICTION_INTERVAL = "friction_interval"
    LOWER_CONFIDENCE_BOUND = "lower_confidence_bound"
    WINTER_SPEED_WHILE_PROVISIONAL = "winter_speed_while_provisional"
    WINTER_SPEED_FEW_VEHICLES = "winter_speed_few_vehicles"
    WINTER_SPEED_STALE_WINDOW = "winter_speed_stale_window"
    WINTER_SPEED_NO_MODEL = "winter_speed_no_model"


@dataclass(frozen=True, slots=True)
class KinematicSummary:
    """The statistics of one trace.

    Attributes:
        values: The kinematic features in the order of the table that the digest names.
        table_digest: Digest of the feature table the values were made for.
        duration_s: Time spent inside the section.
        quality: What the vehicle says about its own summary.
    """

    values: tuple[float, ...]
    table_digest: str
    duration_s: float
    quality: QualityFlag = QualityFlag.NONE


@dataclass(frozen=True, slots=True)
class Passage:
    """One vehicle's pass over a section, as the vehicle sends it (message SUMMARY).

    Attributes:
        passage_id: 16 random bytes, new for every pass; nothing in it identifies a vehicle.
        section_id: The section that was driven.
        map_version: Version of the map the summary was cut with.
        summary: The statistics of the trace.
        age_s: Time since the vehicle left the section, by its own monotonic clock, when the message was sent.
    """

    passage_id: bytes
    section_id: str
    map_version: str
    summary: KinematicSummary
    age_s: float


@dataclass(frozen=True, slots=True)
class Accepted:
    """The passage is stored; whether it counts in the window is said by `flags`."""

    flags: NotCounted = NotCounted.NONE

    @property
    def counted(self) -> bool:
        """Whether the passage enters the window."""
        return self.flags == NotCounted.NONE


@dataclass(frozen=True, slots=True)
class Rejected:
    """Nothing was stored, for this reason. `detail` is for a person and never needed to act."""

    reason: Reason
    detail: str = ""


Outcome: TypeAlias = Accepted | Rejected


@dataclass(frozen=True, slots=True)
class FrictionInterval:
    """The friction [0.8 mu_new, mu_new] that tyres from worn to new find on a section.

    Attributes:
        mu_low: Lower end, 0.8 mu_new.
        mu_new: Upper end, what a new tyre finds; median / 0.9.
        median_mu: Median of the counted estimates.
        median_low_mu: Lower end of the distribution-free confidence interval of the median.
        median_high_mu: Its upper end.
        coverage_frac: Probability with which that interval covers the true median; below the 0.95 asked for when
            there are too few vehicles, 0 when there is no such interval.
        passages_count: Counted passages in the window.
        confidence: The class that count belongs to.
        newest_age_s: Age of the newest counted passage.
        valid_for_s: How long the interval may be used from now.
    """

    mu_low: float
    mu_new: float
    median_mu: float
    median_low_mu: float
    median_high_mu: float
    coverage_frac: float
    passages_count: int
    confidence: Confidence
    newest_age_s: float
    valid_for_s: float


@dataclass(frozen=True, slots=True)
class Advisory:
    """What drivers are told.

    Attributes:
        speed_mps: Advised speed, a multiple of 5 km/h.
        reason: The rule that gave it.
        confidence: Trust in the friction behind it.
        interval: The friction interval, if there is one to publish.
        valid_for_s: How long the advice may be shown after it was received.
    """

    speed_mps: float
    reason: AdvisoryReason
    confidence: Confidence
    interval: FrictionInterval | None
    valid_for_s: float


# Messages on the air. `Passage` above is the message SUMMARY.


@dataclass(frozen=True, slots=True)
class Arrival:
    """A vehicle enters: "send me what I need".

    Attributes:
        passage_id: The id that the passage will carry; it ties the frames of one exchange together.
        section_id: The section it means.
        known_map_version: Version of the map it already has, or the empty string; then the map is not sent again.
        cookie: What the unit gave the vehicle to show that it hears what it is sent; empty before.
    """

    passage_id: bytes
    section_id: str
    known_map_version: str = ""
    cookie: bytes = b""


@dataclass(frozen=True, slots=True)
class Cookie:
    """The unit's question whether an ARRIVAL came from the address it names; the vehicle repeats it with the cookie.

    It must never be longer than the shortest ARRIVAL, so it names no passage: the exchange of its frame does.

    Attributes:
        cookie: 8 bytes that only this unit could have made, and only for this address and exchange.
    """

    cookie: bytes


@dataclass(frozen=True, slots=True)
class MapOffer:
    """The map of a section, with the feature tables that the unit's live models serve."""

    section: RoadSection
    table_digests: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class AdvisoryNotice:
    """An advisory as it is sent, bound to its section, map version and time.

    Attributes:
        issued_unix_s: The unit's wall clock, or 0 when that clock cannot be trusted.
    """

    section_id: str
    map_version: str
    advisory: Advisory
    issued_unix_s: int


@dataclass(frozen=True, slots=True)
class Receipt:
    """The answer to a passage: accepted or rejected, never the estimate, which would train liars."""

    passage_id: bytes
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Beacon:
    """The unit's periodic announcement, by which vehicles find it.

    Attributes:
        issued_unix_s: The unit's wall clock, or 0 when that clock cannot be trusted; tells an old one played again.
    """

    section_id: str
    map_version: str
    speed_mps: float
    reason: AdvisoryReason
    confidence: Confidence
    valid_for_s: float
    issued_unix_s: int


Message: TypeAlias = Arrival | Cookie | MapOffer | AdvisoryNotice | Passage | Receipt | Beacon

PASSAGE_ID_BYTES = 16
VEHICLE_FRAME_BUDGET = 12
"""Frames a vehicle may send in one passage, retransmissions included."""
RSU_FRAME_BUDGET = 8
"""Frames the road side unit may send in one passage, retransmissions included."""
