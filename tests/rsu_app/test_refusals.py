"""Every refusal, through both doors: frames and JSON. Nothing crashes, and what was accepted before stays."""

import asyncio
import struct
import zlib
from dataclasses import replace

import pytest

from bench.certified import AUTHORITIES, OTHER_AUTHORITY_KEY, UNIT, VEHICLE, VERIFIER, signer_of
from roadgrip.certificates import RevocationList, Role
from roadgrip.frames import exchange_id_of, section_key_of, split_into_frames
from roadgrip.protocol import FRAME_LIMIT_BYTES, Kind
from roadgrip.reasons import Reason
from roadgrip.records import Accepted, Passage, Receipt, Rejected
from roadgrip.signing import Signer, Verifier
from roadgrip.wire import encode_message
from rsu_app.signatures import SignatureMode
from tests.rsu_app.fakes import NOON_UNIX_S, make_passage, make_section
from tests.rsu_app.sites import (
    UnitUnderTest,
    frame_of_passage,
    json_text,
    make_unit,
    passage_json,
    radio,
    read_frames,
)

SECTION = make_section()
NAN, INF = float("nan"), float("inf")


def changed(passage: Passage, **changes) -> Passage:
    return replace(passage, summary=replace(passage.summary, **changes))


def frame_with(passage: Passage, *, patch) -> bytes:
    """Change the bytes of a message as its sender could: the checksums are right again."""
    payload = patch(encode_message(passage))
    (frame,) = split_into_frames(
        Kind.SUMMARY,
        payload,
        exchange_id=exchange_id_of(passage.passage_id),
        section_key=section_key_of(passage.section_id),
    )
    return frame


def with_first_value(value: float):
    first = struct.pack("<f", make_passage(SECTION).summary.values[0])
    return lambda payload: payload.replace(first, struct.pack("<f", value), 1)


def with_header_byte(frame: bytes, offset: int, value: int) -> bytes:
    """Change a byte of a frame's header and make its checksum right again."""
    head = bytearray(frame[:24])
    head[offset] = value
    return bytes(head) + struct.pack(">I", zlib.crc32(frame[28:], zlib.crc32(head))) + frame[28:]


def refusal_of(frame: bytes, under_test: UnitUnderTest | None = None) -> Reason:
    (receipt,) = asyncio.run(radio(under_test or make_unit(section=SECTION), frame))
    assert isinstance(receipt, Receipt)
    assert isinstance(receipt.outcome, Rejected)
    return receipt.outcome.reason


P = make_passage(SECTION)
OTHER_DIGEST = "0123456789abcdef"

FRAMES = {
    "malformed": (frame_with(P, patch=lambda payload: payload[:-1]), Reason.MALFORMED),
    "an unknown kind": (with_header_byte(frame_of_passage(P), 3, 99), Reason.MALFORMED),
    "too long for a frame": (frame_of_passage(P) + bytes(FRAME_LIMIT_BYTES), Reason.OVERSIZED),
    "in too many pieces": (with_header_byte(frame_of_passage(P), 17, 9), Reason.OVERSIZED),
    "mis-versioned": (with_header_byte(frame_of_passage(P), 2, 2), Reason.UNSUPPORTED_VERSION),
    "wrong section": (frame_of_passage(replace(P, section_id="elsewhere")), Reason.UNKNOWN_SECTION),
    "wrong map": (frame_of_passage(replace(P, map_version=OTHER_DIGEST)), Reason.STALE_MAP),
    "wrong digest": (frame_of_passage(changed(P, table_digest=OTHER_DIGEST)), Reason.WRONG_FEATURE_TABLE),
    "NaN": (frame_with(P, patch=with_first_value(NAN)), Reason.NOT_FINITE),
    "infinity": (frame_with(P, patch=with_first_value(INF)), Reason.NOT_FINITE),
    "out of range": (frame_with(P, patch=with_first_value(50.0)), Reason.OUT_OF_RANGE),
    "impossible age": (frame_of_passage(replace(P, age_s=100_000.0)), Reason.IMPOSSIBLE_AGE),
    "impossible duration": (frame_of_passage(changed(P, duration_s=1.0)), Reason.IMPOSSIBLE_DURATION),
}


@pytest.mark.parametrize("case", FRAMES)
def test_a_bad_frame_is_answered_with_its_reason(case):
    frame, reason = FRAMES[case]
    assert refusal_of(frame) is reason


JSONS = {
    "malformed": ('{"passage_id": ', 422, "malformed"),
    "not an object": ("[]", 422, "malformed"),
    "a missing key": (json_text({k: v for k, v in passage_json(P).items() if k != "age_s"}), 422, "malformed"),
    "an unknown key": (json_text(passage_json(P, speed_kph=50)), 422, "malformed"),
    "too few values": (json_text(passage_json(P, values=[0.0] * 54)), 422, "malformed"),
    "a value that is text": (json_text(passage_json(P, values=["a"] * 55)), 422, "malformed"),
    "an age that is text": (json_text(passage_json(P, age_s="1.5")), 422, "malformed"),
    "a duration that is a truth value": (json_text(passage_json(P, duration_s=True)), 422, "malformed"),
    "a flag nobody knows": (json_text(passage_json(P, quality=4096)), 422, "malformed"),
    "an id that is too short": (json_text(passage_json(P, passage_id="00")), 422, "malformed"),
    "nested too deeply": ("[" * 30_000 + "]" * 30_000, 422, "malformed"),
    "oversized": (json_text(passage_json(P, values=[0.123456789] * 9_000)), 413, "oversized"),
    "wrong map": (json_text(passage_json(P, map_version=OTHER_DIGEST)), 409, "stale_map"),
    "wrong digest": (json_text(passage_json(P, table_digest=OTHER_DIGEST)), 409, "wrong_feature_table"),
    "NaN": (json_text(passage_json(P, values=[NAN, *P.summary.values[1:]])), 422, "not_finite"),
    "infinity": (json_text(passage_json(P, values=[INF, *P.summary.values[1:]])), 422, "not_finite"),
    "NaN as age": (json_text(passage_json(P, age_s=NAN)), 422, "not_finite"),
    "infinite duration": (json_text(passage_json(P, duration_s=INF)), 422, "not_finite"),
    "too large for a float": (json_text(passage_json(P)).replace('"age_s": 0.0', '"age_s": 1e999'), 422, "not_finite"),
    "out of range": (json_text(passage_json(P, values=[50.0, *P.summary.values[1:]])), 422, "out_of_range"),
    "impossible age": (json_text(passage_json(P, age_s=100_000.0)), 422, "impossible_age"),
    "negative age": (json_text(passage_json(P, age_s=-1.0)), 422, "impossible_age"),
    "impossible duration": (json_text(passage_json(P, duration_s=1.0)), 422, "impossible_duration"),
}


def posted(under_test: UnitUnderTest, body: str, section_id: str = SECTION.section_id):
    async def post():
        async with under_test.client() as client:
            return await client.post(
                f"/v1/sections/{section_id}/passages", content=body, headers={"content-type": "application/json"}
            )

    return asyncio.run(post())


@pytest.mark.parametrize("case", JSONS)
def test_bad_json_is_answered_with_its_reason(case):
    body, status, reason = JSONS[case]
    answer = posted(make_unit(section=SECTION), body)
    assert (answer.status_code, answer.json()["reason"]) == (status, reason)
    assert answer.headers["content-type"] == "application/problem+json"


def test_bad_json_is_counted_as_a_refused_passage_however_bad_it_is():
    under_test = make_unit(section=SECTION)
    for body in ("{", "[" * 30_000 + "]" * 30_000, json_text(passage_json(P, age_s="1.5"))):
        posted(under_test, body)
    labels = {"section": SECTION.section_id, "outcome": "rejected", "reason": "malformed", "via": "json"}
    assert under_test.count("roadgrip_passages_total", **labels) == 3


def test_json_for_a_wrong_section_is_answered_with_its_reason():
    answer = posted(make_unit(section=SECTION), json_text(passage_json(P)), section_id="elsewhere")
    assert (answer.status_code, answer.json()["reason"]) == (404, "unknown_section")


def test_a_damaged_frame_is_dropped_in_silence_since_its_sender_is_unknown():
    under_test = make_unit(section=SECTION)
    damaged = bytearray(frame_of_passage(P))
    damaged[-1] ^= 1
    assert asyncio.run(radio(under_test, bytes(damaged))) == []
    assert under_test.count("roadgrip_frames_dropped_total", via="udp", reason="bad_checksum") == 1


@pytest.mark.parametrize("rubbish", [b"", b"R", b"RG", b"GET / HTTP/1.1\r\n\r\n", bytes(60_000), b"RG" + bytes(10)])
def test_rubbish_is_dropped_in_silence(rubbish):
    under_test = make_unit(section=SECTION)
    assert asyncio.run(radio(under_test, rubbish)) == []


def copied(passage: Passage) -> Passage:
    return replace(passage, passage_id=bytes(range(16)))


def test_the_same_values_under_another_id_are_refused_by_frame():
    under_test = make_unit(section=SECTION)
    asyncio.run(radio(under_test, frame_of_passage(P)))
    assert refusal_of(frame_of_passage(copied(P)), under_test) is Reason.REPLAYED
    assert len(under_test.store.entries) == 1


def test_the_same_values_under_another_id_are_refused_as_json():
    under_test = make_unit(section=SECTION)
    assert posted(under_test, json_text(passage_json(P))).status_code == 200
    answer = posted(under_test, json_text(passage_json(copied(P))))
    assert (answer.status_code, answer.json()["reason"]) == (409, "replayed")


def test_another_passage_under_a_used_id_is_refused_by_frame():
    under_test = make_unit(section=SECTION)
    asyncio.run(radio(under_test, frame_of_passage(P)))
    other = make_passage(SECTION, seed=1, passage_id=P.passage_id)
    assert refusal_of(frame_of_passage(other), under_test) is Reason.PASSAGE_ID_REUSED


def test_another_passage_under_a_used_id_is_refused_as_json():
    under_test = make_unit(section=SECTION)
    posted(under_test, json_text(passage_json(P)))
    answer = posted(under_test, json_text(passage_json(make_passage(SECTION, seed=1, passage_id=P.passage_id))))
    assert (answer.status_code, answer.json()["reason"]) == (409, "passage_id_reused")


def test_an_unsigned_frame_is_refused_where_signatures_are_required():
    under_test = make_unit(section=SECTION, verifier=VERIFIER)
    assert refusal_of(frame_of_passage(P), under_test) is Reason.UNSIGNED
    (receipt,) = asyncio.run(radio(under_test, frame_of_passage(P, signer=VEHICLE)))
    assert receipt == Receipt(P.passage_id, Accepted())


def test_json_is_refused_where_signatures_are_required():
    under_test = make_unit(section=SECTION, verifier=VERIFIER)
    answer = posted(under_test, json_text(passage_json(P)))
    assert (answer.status_code, answer.json()["reason"]) == (403, "unsigned")
    assert under_test.store.entries == []


FORMER = signer_of(Role.VEHICLE, valid_from_unix_s=0, valid_until_unix_s=int(NOON_UNIX_S) - 1)


@pytest.mark.parametrize(
    ("signer", "reason"),
    [
        (Signer(VEHICLE.certificate, OTHER_AUTHORITY_KEY), Reason.BAD_SIGNATURE),
        (signer_of(Role.VEHICLE, authority=OTHER_AUTHORITY_KEY), Reason.UNKNOWN_KEY),
        (FORMER, Reason.CERTIFICATE_EXPIRED),
        (signer_of(Role.VEHICLE, certificate_id=b"stolen!!"), Reason.CERTIFICATE_REVOKED),
        (UNIT, Reason.NOT_PERMITTED),
    ],
    ids=lambda value: value.value if isinstance(value, Reason) else "",
)
@pytest.mark.parametrize("mode", [SignatureMode.OPTIONAL, SignatureMode.REQUIRED])
def test_a_fake_car_is_refused_with_its_reason(signer, reason, mode):
    revoked = RevocationList(0, 2**40, frozenset({b"stolen!!"}))
    under_test = make_unit(section=SECTION, verifier=Verifier(AUTHORITIES, revocations=revoked), mode=mode)
    assert refusal_of(frame_of_passage(P, signer=signer), under_test) is reason
    assert under_test.count("roadgrip_frames_dropped_total", via="udp", reason=reason.value) == 1
    assert under_test.store.entries == []


@pytest.mark.parametrize("later_s", [-301.0, 301.0])
def test_a_recorded_passage_that_is_played_again_is_refused(later_s):
    under_test = make_unit(section=SECTION, verifier=VERIFIER)
    under_test.clock.now_unix_s += later_s
    assert refusal_of(frame_of_passage(P, signer=VEHICLE), under_test) is Reason.OUTSIDE_REPLAY_WINDOW


def test_a_unit_without_a_clock_judges_signatures_and_no_dates():
    under_test = make_unit(section=SECTION, verifier=VERIFIER)
    under_test.clock.now_unix_s = 1000.0
    (receipt,) = asyncio.run(radio(under_test, frame_of_passage(P, signer=FORMER)))
    assert receipt == Receipt(P.passage_id, Accepted())
    assert refusal_of(frame_of_passage(P, signer=UNIT), under_test) is Reason.NOT_PERMITTED


def test_signatures_that_are_not_asked_for_are_taken_off_unread():
    under_test = make_unit(section=SECTION, verifier=VERIFIER, mode=SignatureMode.OFF)
    stranger = signer_of(Role.VEHICLE, authority=OTHER_AUTHORITY_KEY)
    (receipt,) = asyncio.run(radio(under_test, frame_of_passage(P, signer=stranger)))
    assert receipt == Receipt(P.passage_id, Accepted())


def test_a_unit_without_a_model_says_so_through_both_doors():
    under_test = make_unit(section=SECTION, model=False)
    assert refusal_of(frame_of_passage(P), under_test) is Reason.NO_MODEL
    answer = posted(under_test, json_text(passage_json(P)))
    assert (answer.status_code, answer.json()["may_retry"], answer.headers["retry-after"]) == (503, True, "5")


def test_all_refusals_together_leave_the_accepted_passage_alone():
    under_test = make_unit(section=SECTION)
    first = make_passage(SECTION, seed=7)
    assert posted(under_test, json_text(passage_json(first))).status_code == 200
    for frame, _ in FRAMES.values():
        asyncio.run(radio(under_test, frame))
    for body, _, _ in JSONS.values():
        posted(under_test, body)
    assert [e.passage.passage_id for e in under_test.store.entries] == [first.passage_id]
    assert posted(under_test, json_text(passage_json(first))).json()["counted"] is True


def test_frames_over_http_are_refused_as_over_the_radio():
    async def post(frame: bytes):
        async with make_unit(section=SECTION).client() as client:
            return await client.post(
                "/v1/frames", content=frame, headers={"content-type": "application/vnd.roadgrip.frames"}
            )

    for case, (frame, reason) in FRAMES.items():
        answer = asyncio.run(post(frame))
        if answer.status_code == 200:
            (receipt,) = read_frames([answer.content])
            assert isinstance(receipt, Receipt), case
            assert receipt.outcome == Rejected(reason, receipt.outcome.detail), case  # type: ignore[union-attr]
        else:
            # A body whose frames cannot be told apart has no exchange to answer to.
            assert answer.json()["reason"] in {"malformed", "oversized"}, case
