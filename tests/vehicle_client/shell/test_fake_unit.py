"""A fake unit advises 100 km/h on ice. A car that trusts an authority ignores it, counts it, and says why."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bench.certified import (
    AUTHORITIES,
    NOW_UNIX_S,
    OTHER_AUTHORITY_KEY,
    UNIT,
    UNIT_KEY,
    VEHICLE,
    VERIFIER,
    YEAR_S,
    claims_for,
    signer_of,
)
from roadgrip.certificates import RevocationList, Role
from roadgrip.features import NEWEST_TABLE
from roadgrip.frames import exchange_id_of, section_key_of, split_into_frames
from roadgrip.reasons import Reason
from roadgrip.records import Accepted, AdvisoryNotice, MapOffer, Message, Receipt, Rejected
from roadgrip.signing import Claims, Signer, Verifier
from roadgrip.units import kph_to_mps
from roadgrip.wire import encode_message, kind_of
from tests.vehicle_client.shell.air import ADVICE, BEND, PASSAGE_ID, SUMMARY, bend
from vehicle_client.shell.codec import WireCodec
from vehicle_client.shell.exchange import Ending, Exchange, Stage

FAST = replace(ADVICE, speed_mps=kph_to_mps(100.0))
NOTICE = AdvisoryNotice("bend", BEND.version, FAST, issued_unix_s=NOW_UNIX_S)
OFFER = MapOffer(BEND, (NEWEST_TABLE.digest,))
EXCHANGE_ID = exchange_id_of(PASSAGE_ID)


def frames_of(
    message: Message,
    *,
    signer: Signer | None,
    claims: Claims | None = None,
    exchange_id: bytes = EXCHANGE_ID,
    now_unix_s: int = NOW_UNIX_S,
) -> tuple[bytes, ...]:
    """Return what a unit sends; `exchange_id` is whose answer it was signed as, while it flies in ours."""
    said = claims or claims_for(message, section_id="bend", map_version=BEND.version, now_unix_s=now_unix_s)
    return split_into_frames(
        kind_of(message),
        encode_message(message, signer=signer, exchange_id=exchange_id, claims=said),
        exchange_id=EXCHANGE_ID,
        section_key=section_key_of("bend"),
    )


def an_exchange(*, verifier: Verifier = VERIFIER, now_unix_s: float | None = NOW_UNIX_S + 1.0) -> Exchange:
    codec = WireCodec(
        PASSAGE_ID, section_id="bend", timeout_s=10.0, signer=VEHICLE, verifier=verifier, unix_s=lambda: now_unix_s
    )
    exchange = Exchange(passage_id=PASSAGE_ID, section_id="bend", codec=codec, known_section=BEND)
    exchange.begin(now_s=0.0)
    return exchange


def hear(exchange: Exchange, frames: tuple[bytes, ...]) -> None:
    for frame in frames:
        exchange.receive(frame, now_s=0.1)


REVOKING = Verifier(AUTHORITIES, revocations=RevocationList(NOW_UNIX_S, 2**40, frozenset({b"stolen!!"})))

FAKE_SIGNERS: dict[str, tuple[Signer | None, Reason]] = {
    "unsigned": (None, Reason.UNSIGNED),
    "certified by itself": (signer_of(Role.UNIT, private_key=UNIT_KEY, authority=UNIT_KEY), Reason.UNKNOWN_KEY),
    "of another authority": (signer_of(Role.UNIT, authority=OTHER_AUTHORITY_KEY), Reason.UNKNOWN_KEY),
    "with a certificate that it only heard": (Signer(UNIT.certificate, OTHER_AUTHORITY_KEY), Reason.BAD_SIGNATURE),
    "certificate ended": (
        signer_of(Role.UNIT, valid_from_unix_s=0, valid_until_unix_s=NOW_UNIX_S - YEAR_S),
        Reason.CERTIFICATE_EXPIRED,
    ),
    "certificate not begun": (signer_of(Role.UNIT, valid_from_unix_s=NOW_UNIX_S + 60), Reason.CERTIFICATE_EXPIRED),
    "certified for another section": (signer_of(Role.UNIT, section_ids=("another-bend",)), Reason.NOT_PERMITTED),
    "a vehicle": (VEHICLE, Reason.NOT_PERMITTED),
    "revoked": (signer_of(Role.UNIT, certificate_id=b"stolen!!"), Reason.CERTIFICATE_REVOKED),
}
FAKES = {name: (frames_of(NOTICE, signer=signer), reason) for name, (signer, reason) in FAKE_SIGNERS.items()} | {
    "claims for another section": (
        frames_of(NOTICE, signer=UNIT, claims=Claims(NOW_UNIX_S, NOW_UNIX_S + 60, "another-bend", BEND.version)),
        Reason.MALFORMED,
    ),
    "claims for another map": (
        frames_of(NOTICE, signer=UNIT, claims=Claims(NOW_UNIX_S, NOW_UNIX_S + 60, "bend", "0" * 16)),
        Reason.MALFORMED,
    ),
    "claims nothing": (frames_of(NOTICE, signer=UNIT, claims=Claims(NOW_UNIX_S)), Reason.NOT_PERMITTED),
    "advice of an hour ago": (
        frames_of(NOTICE, signer=UNIT, now_unix_s=NOW_UNIX_S - 3600),
        Reason.OUTSIDE_REPLAY_WINDOW,
    ),
    "an answer to somebody else, recorded": (
        frames_of(NOTICE, signer=UNIT, exchange_id=b"earlier."),
        Reason.BAD_SIGNATURE,
    ),
}


def test_the_unit_that_is_none_of_these_is_believed():
    exchange = an_exchange(verifier=REVOKING)
    hear(exchange, frames_of(NOTICE, signer=UNIT))
    assert exchange.advisory is not None
    assert exchange.advisory.speed_mps == pytest.approx(FAST.speed_mps)
    assert exchange.record().refusals == {}


@pytest.mark.parametrize("name", FAKES)
def test_a_fake_unit_is_ignored_and_counted(name: str):
    frames, reason = FAKES[name]
    exchange = an_exchange(verifier=REVOKING)
    hear(exchange, frames)
    assert exchange.advisory is None
    assert exchange.stage is Stage.ARRIVING
    assert exchange.record().refusals == {reason: 1}
    assert exchange.record().frames_refused_count == 1


@pytest.mark.parametrize("name", FAKE_SIGNERS)
def test_a_fake_unit_neither_ends_an_exchange_nor_gives_it_a_map(name: str):
    signer, reason = FAKE_SIGNERS[name]
    exchange = an_exchange(verifier=REVOKING)
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    for outcome in (Accepted(), Rejected(Reason.STALE_MAP)):
        hear(exchange, frames_of(Receipt(PASSAGE_ID, outcome), signer=signer))
    hear(exchange, frames_of(MapOffer(bend(speed_limit_mps=40.0), (NEWEST_TABLE.digest,)), signer=signer))
    assert exchange.stage is Stage.REPORTING
    assert exchange.section == BEND
    assert exchange.record().ending is Ending.UNANSWERED
    assert exchange.record().refusals == {reason: 3}


def test_advice_that_was_heard_before_is_not_taken_twice():
    exchange = an_exchange()
    hear(exchange, frames_of(NOTICE, signer=UNIT))
    hear(exchange, frames_of(NOTICE, signer=UNIT))
    assert exchange.record().messages_ignored_count == 1


def test_a_car_without_a_clock_judges_everything_but_dates():
    exchange = an_exchange(verifier=REVOKING, now_unix_s=None)
    for name in ("unsigned", "of another authority", "certified for another section", "a vehicle", "revoked"):
        hear(exchange, FAKES[name][0])
    assert exchange.advisory is None
    hear(exchange, FAKES["certificate ended"][0])
    assert exchange.advisory is not None


def test_an_answer_to_the_own_arrival_needs_no_clock_at_the_unit():
    exchange = an_exchange()
    hear(exchange, frames_of(OFFER, signer=UNIT, claims=Claims(None, None, "bend", BEND.version)))
    hear(exchange, frames_of(NOTICE, signer=UNIT, claims=Claims(None, None, "bend", BEND.version)))
    assert exchange.advisory is not None


def test_a_receipt_for_another_map_than_the_summary_was_cut_with_is_not_believed():
    exchange = an_exchange()
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    other = Claims(NOW_UNIX_S, NOW_UNIX_S + 60, "bend", "0" * 16)
    hear(exchange, frames_of(Receipt(PASSAGE_ID, Accepted()), signer=UNIT, claims=other))
    assert exchange.stage is Stage.REPORTING
    hear(exchange, frames_of(Receipt(PASSAGE_ID, Accepted()), signer=UNIT))
    assert exchange.record().ending is Ending.ACCEPTED


def test_a_refusal_may_be_signed_for_the_map_that_the_vehicle_does_not_have():
    exchange = an_exchange()
    exchange.report(SUMMARY, map_version=BEND.version, left_at_s=0.0, now_s=0.0)
    newer = Claims(NOW_UNIX_S, NOW_UNIX_S + 60, "bend", "0" * 16)
    hear(exchange, frames_of(Receipt(PASSAGE_ID, Rejected(Reason.STALE_MAP)), signer=UNIT, claims=newer))
    assert exchange.record().ending is Ending.REJECTED
