"""The numbers that the two ends of the air have agreed on. Nothing here may change within a version of the format."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from roadgrip.reasons import Reason
from roadgrip.records import AdvisoryReason, Confidence
from roadgrip.section import BankOrigin, Direction

PROTOCOL_NAME = "roadgrip"
PROTOCOL_VERSION = 1
FRAME_LIMIT_BYTES = 1400
"""Fits one packet of every radio and network in question with room for their headers."""
HEADER_BYTES = 28
FRAGMENT_BYTES = FRAME_LIMIT_BYTES - HEADER_BYTES
"""The longest piece of a message that one frame carries."""


class Kind(IntEnum):
    """What a message is; the number stands in the header of every frame."""

    ARRIVAL = 1
    MAP = 2
    ADVISORY = 3
    SUMMARY = 4
    RECEIPT = 5
    BEACON = 6
    COOKIE = 7


FRAMES_LIMIT_COUNT: Mapping[Kind, int] = {kind: 5 if kind is Kind.MAP else 1 for kind in Kind}
"""Into how many frames a message of each kind may be cut. Five for the map leave the unit three of its eight: one each
for COOKIE, ADVISORY and RECEIPT."""
COOKIE_BYTES = 8

REASON_CODES: Mapping[Reason, int] = {
    Reason.MALFORMED: 1,
    Reason.OVERSIZED: 2,
    Reason.BAD_CHECKSUM: 3,
    Reason.UNSUPPORTED_VERSION: 4,
    Reason.UNSIGNED: 5,
    Reason.BAD_SIGNATURE: 6,
    Reason.UNKNOWN_KEY: 7,
    Reason.UNKNOWN_SECTION: 8,
    Reason.STALE_MAP: 9,
    Reason.WRONG_FEATURE_TABLE: 10,
    Reason.NOT_FINITE: 11,
    Reason.OUT_OF_RANGE: 12,
    Reason.IMPOSSIBLE_AGE: 13,
    Reason.IMPOSSIBLE_DURATION: 14,
    Reason.PASSAGE_ID_REUSED: 15,
    Reason.REPLAYED: 16,
    Reason.BUDGET_EXHAUSTED: 17,
    Reason.BUSY: 18,
    Reason.NO_MODEL: 19,
    Reason.STORE_UNAVAILABLE: 20,
    Reason.TOO_SHORT: 21,
    Reason.TOO_MANY_GAPS: 22,
    Reason.TOO_SLOW: 23,
    Reason.WRONG_ROAD: 24,
    Reason.PASSAGE_ABORTED: 25,
    Reason.SENSOR_FAULT: 26,
    Reason.CERTIFICATE_EXPIRED: 27,
    Reason.CERTIFICATE_REVOKED: 28,
    Reason.NOT_PERMITTED: 29,
    Reason.OUTSIDE_REPLAY_WINDOW: 30,
    Reason.RATE_LIMITED: 31,
}
ADVISORY_REASON_CODES: Mapping[AdvisoryReason, int] = {
    AdvisoryReason.FRICTION_INTERVAL: 0,
    AdvisoryReason.LOWER_CONFIDENCE_BOUND: 1,
    AdvisoryReason.WINTER_SPEED_WHILE_PROVISIONAL: 2,
    AdvisoryReason.WINTER_SPEED_FEW_VEHICLES: 3,
    AdvisoryReason.WINTER_SPEED_STALE_WINDOW: 4,
    AdvisoryReason.WINTER_SPEED_NO_MODEL: 5,
}
CONFIDENCE_CODES: Mapping[Confidence, int] = {
    Confidence.INSUFFICIENT: 0,
    Confidence.PROVISIONAL: 1,
    Confidence.RECOMMENDED: 2,
}
DIRECTION_CODES: Mapping[Direction, int] = {Direction.WITH: 0, Direction.AGAINST: 1}
BANK_ORIGIN_CODES: Mapping[BankOrigin, int] = {
    BankOrigin.MEASURED: 0,
    BankOrigin.INFERRED: 1,
    BankOrigin.NONE: 2,
}


def external_aad_of(kind: Kind, *, exchange_id: bytes) -> bytes:
    """Return what a signature covers besides the message, without being sent: protocol, version and kind.

    That of an ADVISORY also covers the exchange id, which the vehicle drew at random: an old advisory, put into new
    frames and played again, does not verify. The other kinds hold a passage id, or their claims say until when.
    """
    name = _EXTERNAL_AADS[kind]
    return name + b"/" + exchange_id if kind is Kind.ADVISORY else name


_EXTERNAL_AADS = {kind: f"{PROTOCOL_NAME}/{PROTOCOL_VERSION}/{kind.name}".encode() for kind in Kind}
