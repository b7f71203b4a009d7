"""The codes of refusal that both ends of the air, the metrics and the documentation share."""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """Why something was refused. The sender sees the value, the metric counts it, the documentation lists it."""

    # Bytes that are not a message.
    MALFORMED = "malformed"
    OVERSIZED = "oversized"
    BAD_CHECKSUM = "bad_checksum"
    UNSUPPORTED_VERSION = "unsupported_version"
    UNSIGNED = "unsigned"
    BAD_SIGNATURE = "bad_signature"
    UNKNOWN_KEY = "unknown_key"
    # Signed well, by somebody who may not say it, or not now.
    CERTIFICATE_EXPIRED = "certificate_expired"
    CERTIFICATE_REVOKED = "certificate_revoked"
    NOT_PERMITTED = "not_permitted"
    OUTSIDE_REPLAY_WINDOW = "outside_replay_window"
    # A message that does not belong here.
    UNKNOWN_SECTION = "unknown_section"
    STALE_MAP = "stale_map"
    WRONG_FEATURE_TABLE = "wrong_feature_table"
    # A passage that cannot be.
    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    IMPOSSIBLE_AGE = "impossible_age"
    IMPOSSIBLE_DURATION = "impossible_duration"
    PASSAGE_ID_REUSED = "passage_id_reused"
    REPLAYED = "replayed"
    # The receiver's own limits; the sender may try again later.
    BUDGET_EXHAUSTED = "budget_exhausted"
    BUSY = "busy"
    RATE_LIMITED = "rate_limited"
    NO_MODEL = "no_model"
    STORE_UNAVAILABLE = "store_unavailable"
    # The vehicle keeps its summary to itself.
    TOO_SHORT = "too_short"
    TOO_MANY_GAPS = "too_many_gaps"
    TOO_SLOW = "too_slow"
    WRONG_ROAD = "wrong_road"
    PASSAGE_ABORTED = "passage_aborted"
    SENSOR_FAULT = "sensor_fault"

    @property
    def may_retry(self) -> bool:
        """Whether the same message may be accepted later without change."""
        return self in _MAY_RETRY


_MAY_RETRY = frozenset({Reason.BUSY, Reason.RATE_LIMITED, Reason.NO_MODEL, Reason.STORE_UNAVAILABLE})
