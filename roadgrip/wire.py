"""The messages on the air: bytes to records and back.

A message is one deterministic CBOR map with small integer keys (`docs/wire.cddl` is the schema), optionally inside a
COSE_Sign1. All quantities but the statistics of a summary are integers in fixed steps, so NaN has no spelling, and
what was decoded encodes to the same bytes again. The statistics are 32-bit floats.

What is checked here is structure: that the bytes are a message and every number is one. Whether a passage can be
believed is decided behind the door.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

from roadgrip.cbor import strict_dumps, strict_loads
from roadgrip.errors import WireError
from roadgrip.protocol import (
    ADVISORY_REASON_CODES,
    CONFIDENCE_CODES,
    COOKIE_BYTES,
    FRAGMENT_BYTES,
    FRAMES_LIMIT_COUNT,
    REASON_CODES,
    Kind,
    external_aad_of,
)
from roadgrip.reasons import Reason
from roadgrip.records import (
    PASSAGE_ID_BYTES,
    Accepted,
    Advisory,
    AdvisoryNotice,
    Arrival,
    Beacon,
    Cookie,
    FrictionInterval,
    MapOffer,
    Message,
    NotCounted,
    Passage,
    Receipt,
    Rejected,
)
from roadgrip.signing import NO_CLAIMS, Claims, Signed, Signer, Verifier, is_signed, open_payload, sign
from roadgrip.units import kph_to_mps, mps_to_kph
from roadgrip.wire_fields import (
    UINT16_MAX,
    UINT32_MAX,
    UNIX_LIMIT_S,
    Fields,
    bytes_in,
    check_keys,
    checked_int,
    checked_passage_id,
    checked_section_id,
    digest_bytes,
    digest_in,
    int_in,
    meaning_of,
    meanings,
    quanta,
    text_in,
)
from roadgrip.wire_map import map_from_fields, map_to_fields
from roadgrip.wire_summary import summary_at_once, summary_from_fields, summary_to_fields

__all__ = ["Kind", "Received", "decode_message", "encode_message", "kind_of", "open_message", "rounded_to_wire"]

M = TypeVar("M", bound=Message)

DETAIL_LIMIT_CHARS = 120
"""The detail of a rejection is cut here; nobody needs it to act."""
_REASONS = meanings(REASON_CODES)
_ADVISORY_REASONS = meanings(ADVISORY_REASON_CODES)
_CONFIDENCES = meanings(CONFIDENCE_CODES)
_ALL_NOT_COUNTED = sum(NotCounted)
_INTERVAL_FIELDS_COUNT = 10


class Received(NamedTuple):
    """A message that was read.

    Attributes:
        message: What it says.
        signed: Who has signed it and what was claimed, if it was signed and the receiver looked.
    """

    message: Message
    signed: Signed | None


def encode_message(
    message: Message, *, signer: Signer | None = None, exchange_id: bytes = b"", claims: Claims = NO_CLAIMS
) -> bytes:
    """Return the bytes of a message, the payload that `roadgrip.frames.split_into_frames` cuts.

    Numbers are rounded to the steps of the format, see `rounded_to_wire`.

    Args:
        message: The record.
        signer: Signs it, if given; a COOKIE is never signed.
        exchange_id: In whose frames it flies; the signature of an ADVISORY covers it.
        claims: What the signer says besides; see `roadgrip.belief.unit_claims` for a unit.

    Raises:
        WireError: The record holds what has no spelling on the air; the reason is the one a receiver would give.
    """
    kind = kind_of(message)
    payload = _CODECS[kind].written(message)
    if signer is not None and kind is not Kind.COOKIE:
        aad = external_aad_of(kind, exchange_id=exchange_id)
        payload = sign(payload, signer=signer, external_aad=aad, claims=claims)
    _check_size(kind, payload)
    return payload


def open_message(
    kind: Kind, payload: bytes, *, verifier: Verifier | None = None, required: bool = False, exchange_id: bytes = b""
) -> Received:
    """Return the record that the bytes of a message hold, and who has signed it.

    Whether the signer may say so, and now, is judged in `roadgrip.belief`.

    Args:
        kind: What the frames said it is.
        payload: The bytes, whole.
        verifier: Checks the signature; see `roadgrip.signing.open_payload` for what None means.
        required: Whether an unsigned message is refused; a COOKIE, which decides nothing, never is.
        exchange_id: In whose frames it came.

    Raises:
        WireError: OVERSIZED, MALFORMED, NOT_FINITE, OUT_OF_RANGE, IMPOSSIBLE_AGE, IMPOSSIBLE_DURATION, UNSIGNED,
            BAD_SIGNATURE, UNKNOWN_KEY or CERTIFICATE_REVOKED.
    """
    _check_size(kind, payload)
    content, signed = payload, None
    if (required or is_signed(payload)) and kind is not Kind.COOKIE:
        aad = external_aad_of(kind, exchange_id=exchange_id)
        content, signed = open_payload(payload, verifier=verifier, required=required, external_aad=aad)
    return Received(_CODECS[kind].read(content), signed)


def decode_message(kind: Kind, payload: bytes) -> Message:
    """Return the record that the bytes of a message hold, for readers who do not ask who has signed it.

    Raises:
        WireError: As `open_message`.
    """
    return open_message(kind, payload).message


def kind_of(message: Message) -> Kind:
    """Return what a record is on the air."""
    return _KINDS[type(message)]


def rounded_to_wire(message: M) -> M:
    """Return the message as its receiver will see it; rounding twice changes nothing more.

    Statistics are rounded to 32-bit floats, times to 10 ms, friction to 1e-4, advised speeds to 0.01 km/h; a long
    detail of a rejection is cut.

    Raises:
        WireError: As `encode_message`.
    """
    kind = kind_of(message)
    rounded: M = _CODECS[kind].from_fields(_CODECS[kind].to_fields(message))
    return rounded


def _check_size(kind: Kind, payload: bytes) -> None:
    limit = FRAMES_LIMIT_COUNT[kind] * FRAGMENT_BYTES
    if len(payload) > limit:
        raise WireError(Reason.OVERSIZED, f"{kind.name} of {len(payload)} bytes; {limit} are possible")


# ARRIVAL and COOKIE

_ARRIVAL_KEYS = frozenset({0, 1})
_ARRIVAL_OPTIONAL = frozenset({2, 3})


def _arrival_to_fields(arrival: Arrival) -> Fields:
    fields: Fields = {0: checked_passage_id(arrival.passage_id), 1: checked_section_id(arrival.section_id)}
    if arrival.known_map_version:
        fields[2] = digest_bytes(arrival.known_map_version, name="the map version")
    if arrival.cookie:
        fields[3] = _checked_cookie(arrival.cookie)
    return fields


def _arrival_from_fields(value: object) -> Arrival:
    fields = check_keys(value, required=_ARRIVAL_KEYS, optional=_ARRIVAL_OPTIONAL)
    return Arrival(
        passage_id=bytes_in(fields, 0, size=PASSAGE_ID_BYTES, name="the passage id"),
        section_id=checked_section_id(fields[1]),
        known_map_version=digest_in(fields, 2, name="the map version") if 2 in fields else "",
        cookie=bytes_in(fields, 3, size=COOKIE_BYTES, name="the cookie") if 3 in fields else b"",
    )


def _cookie_to_fields(cookie: Cookie) -> Fields:
    return {0: _checked_cookie(cookie.cookie)}


def _cookie_from_fields(value: object) -> Cookie:
    fields = check_keys(value, required=frozenset({0}))
    return Cookie(bytes_in(fields, 0, size=COOKIE_BYTES, name="the cookie"))


def _checked_cookie(cookie: bytes) -> bytes:
    if len(cookie) != COOKIE_BYTES:
        raise WireError(Reason.MALFORMED, f"a cookie is {COOKIE_BYTES} bytes")
    return cookie


# ADVISORY and BEACON

_BEACON_KEYS = frozenset({0, 1, 2, 3, 4, 5, 7})
"""Without 6, which every ADVISORY has: neither passes for the other, signed or not."""

_INTERVAL_LIMITS: tuple[tuple[str, int, int], ...] = (
    ("the lower friction", 10_000, UINT16_MAX),
    ("the upper friction", 10_000, UINT16_MAX),
    ("the median friction", 10_000, UINT16_MAX),
    ("the median's lower bound", 10_000, UINT16_MAX),
    ("the median's upper bound", 10_000, UINT16_MAX),
    ("the coverage", 10_000, 10_000),
    ("the number of passages", 1, UINT32_MAX),
    ("the newest age", 100, UINT32_MAX),
    ("the validity", 100, UINT32_MAX),
)


def _interval_to_array(interval: FrictionInterval) -> list[int]:
    values = (
        interval.mu_low,
        interval.mu_new,
        interval.median_mu,
        interval.median_low_mu,
        interval.median_high_mu,
        interval.coverage_frac,
        interval.passages_count,
        interval.newest_age_s,
        interval.valid_for_s,
    )
    steps = [
        quanta(value, per_unit=per_unit, name=name, high=high)
        for value, (name, per_unit, high) in zip(values, _INTERVAL_LIMITS, strict=True)
    ]
    return [*steps, CONFIDENCE_CODES[interval.confidence]]


def _interval_from_array(value: object) -> FrictionInterval:
    if type(value) is not list or len(value) != _INTERVAL_FIELDS_COUNT:
        raise WireError(Reason.MALFORMED, "a friction interval is ten numbers")
    low, new, median, median_low, median_high, coverage, count, age, validity = (
        checked_int(steps, name=name, low=0, high=high)
        for steps, (name, _, high) in zip(value[:-1], _INTERVAL_LIMITS, strict=True)
    )
    return FrictionInterval(
        mu_low=low / 10_000,
        mu_new=new / 10_000,
        median_mu=median / 10_000,
        median_low_mu=median_low / 10_000,
        median_high_mu=median_high / 10_000,
        coverage_frac=coverage / 10_000,
        passages_count=count,
        confidence=meaning_of(value[-1], _CONFIDENCES, name="confidence"),
        newest_age_s=age / 100,
        valid_for_s=validity / 100,
    )


def _speed_quanta(speed_mps: float) -> int:
    # Hundredths of km/h, not cm/s: 60 km/h would come out as 60.012 and stand above a limit of 60.
    return quanta(mps_to_kph(speed_mps), per_unit=100, name="the advised speed", high=UINT16_MAX)


def _speed_mps_in(fields: Fields, key: int) -> float:
    return kph_to_mps(int_in(fields, key, name="the advised speed", high=UINT16_MAX) / 100)


def _advisory_to_fields(notice: AdvisoryNotice) -> Fields:
    advisory = notice.advisory
    fields: Fields = {
        0: checked_section_id(notice.section_id),
        1: digest_bytes(notice.map_version, name="the map version"),
        2: quanta(notice.issued_unix_s, per_unit=1, name="the time of issue", high=UNIX_LIMIT_S),
        3: _speed_quanta(advisory.speed_mps),
        4: ADVISORY_REASON_CODES[advisory.reason],
        5: CONFIDENCE_CODES[advisory.confidence],
        6: quanta(advisory.valid_for_s, per_unit=100, name="the validity"),
    }
    if advisory.interval is not None:
        fields[7] = _interval_to_array(advisory.interval)
    return fields


def _advisory_from_fields(value: object) -> AdvisoryNotice:
    fields = check_keys(value, required=frozenset(range(7)), optional=frozenset({7}))
    return AdvisoryNotice(
        section_id=checked_section_id(fields[0]),
        map_version=digest_in(fields, 1, name="the map version"),
        advisory=Advisory(
            speed_mps=_speed_mps_in(fields, 3),
            reason=meaning_of(fields[4], _ADVISORY_REASONS, name="reason of an advisory"),
            confidence=meaning_of(fields[5], _CONFIDENCES, name="confidence"),
            interval=_interval_from_array(fields[7]) if 7 in fields else None,
            valid_for_s=int_in(fields, 6, name="the validity") / 100,
        ),
        issued_unix_s=int_in(fields, 2, name="the time of issue", high=UNIX_LIMIT_S),
    )


def _beacon_to_fields(beacon: Beacon) -> Fields:
    return {
        0: checked_section_id(beacon.section_id),
        1: digest_bytes(beacon.map_version, name="the map version"),
        2: _speed_quanta(beacon.speed_mps),
        3: ADVISORY_REASON_CODES[beacon.reason],
        4: CONFIDENCE_CODES[beacon.confidence],
        5: quanta(beacon.valid_for_s, per_unit=100, name="the validity"),
        7: quanta(beacon.issued_unix_s, per_unit=1, name="the time of issue", high=UNIX_LIMIT_S),
    }


def _beacon_from_fields(value: object) -> Beacon:
    fields = check_keys(value, required=_BEACON_KEYS)
    return Beacon(
        section_id=checked_section_id(fields[0]),
        map_version=digest_in(fields, 1, name="the map version"),
        speed_mps=_speed_mps_in(fields, 2),
        reason=meaning_of(fields[3], _ADVISORY_REASONS, name="reason of an advisory"),
        confidence=meaning_of(fields[4], _CONFIDENCES, name="confidence"),
        valid_for_s=int_in(fields, 5, name="the validity") / 100,
        issued_unix_s=int_in(fields, 7, name="the time of issue", high=UNIX_LIMIT_S),
    )


# RECEIPT


def _receipt_to_fields(receipt: Receipt) -> Fields:
    passage_id = checked_passage_id(receipt.passage_id)
    match receipt.outcome:
        case Accepted(flags):
            return {0: passage_id, 1: int(flags)}
        case Rejected(reason, detail):
            fields: Fields = {0: passage_id, 2: REASON_CODES[reason]}
            if detail:
                # It may quote what a stranger sent; nothing that a terminal obeys leaves or enters.
                fields[3] = "".join(c if c.isprintable() else "?" for c in detail[:DETAIL_LIMIT_CHARS])
            return fields


def _acceptance_at_once(receipt: Receipt) -> bytes | None:
    outcome = receipt.outcome
    if isinstance(outcome, Rejected) or outcome.flags > _ALL_NOT_COUNTED:
        return None
    return b"\xa2\x00\x50%b\x01%c" % (checked_passage_id(receipt.passage_id), outcome.flags)


def _receipt_from_fields(value: object) -> Receipt:
    outcome: Accepted | Rejected
    if type(value) is dict and 1 in value:
        fields = check_keys(value, required=frozenset({0, 1}))
        outcome = Accepted(NotCounted(int_in(fields, 1, name="the flags", high=_ALL_NOT_COUNTED)))
    else:
        fields = check_keys(value, required=frozenset({0, 2}), optional=frozenset({3}))
        detail = text_in(fields, 3, limit_chars=DETAIL_LIMIT_CHARS, name="the detail") if 3 in fields else ""
        if not detail.isprintable():
            raise WireError(Reason.MALFORMED, "the detail is not printable")
        outcome = Rejected(meaning_of(fields[2], _REASONS, name="reason"), detail)
    return Receipt(passage_id=bytes_in(fields, 0, size=PASSAGE_ID_BYTES, name="the passage id"), outcome=outcome)


class _Codec(NamedTuple):
    """How one message is written and read.

    What thousands pass in a second has a shorter way, which gives the same or nothing.
    """

    to_fields: Callable[[Any], Fields]
    from_fields: Callable[[object], Any]
    write_at_once: Callable[[Any], bytes | None] = lambda _: None
    read_at_once: Callable[[bytes], Any] = lambda _: None

    def written(self, message: Message) -> bytes:
        return self.write_at_once(message) or strict_dumps(self.to_fields(message))

    def read(self, content: bytes) -> Any:
        message = self.read_at_once(content)
        return self.from_fields(strict_loads(content)) if message is None else message


_CODECS: Mapping[Kind, _Codec] = {
    Kind.ARRIVAL: _Codec(_arrival_to_fields, _arrival_from_fields),
    Kind.MAP: _Codec(map_to_fields, map_from_fields),
    Kind.ADVISORY: _Codec(_advisory_to_fields, _advisory_from_fields),
    Kind.SUMMARY: _Codec(summary_to_fields, summary_from_fields, read_at_once=summary_at_once),
    Kind.RECEIPT: _Codec(_receipt_to_fields, _receipt_from_fields, write_at_once=_acceptance_at_once),
    Kind.BEACON: _Codec(_beacon_to_fields, _beacon_from_fields),
    Kind.COOKIE: _Codec(_cookie_to_fields, _cookie_from_fields),
}
_KINDS: Mapping[type, Kind] = {
    Arrival: Kind.ARRIVAL,
    MapOffer: Kind.MAP,
    AdvisoryNotice: Kind.ADVISORY,
    Passage: Kind.SUMMARY,
    Receipt: Kind.RECEIPT,
    Beacon: Kind.BEACON,
    Cookie: Kind.COOKIE,
}
