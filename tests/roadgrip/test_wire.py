"""Messages keep what they say, and what is not a message is refused with its reason."""

import dataclasses
import math
import struct
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import given

from bench.certified import rightful_signer_of, signer_of
from roadgrip.certificates import Role
from roadgrip.errors import WireError
from roadgrip.features import PAPER_TABLE, road_features
from roadgrip.protocol import (
    ADVISORY_REASON_CODES,
    BANK_ORIGIN_CODES,
    CONFIDENCE_CODES,
    DIRECTION_CODES,
    FRAGMENT_BYTES,
    FRAMES_LIMIT_COUNT,
    REASON_CODES,
)
from roadgrip.reasons import Reason
from roadgrip.records import (
    Accepted,
    Advisory,
    AdvisoryNotice,
    AdvisoryReason,
    Arrival,
    Beacon,
    Confidence,
    KinematicSummary,
    MapOffer,
    Message,
    NotCounted,
    Passage,
    QualityFlag,
    Receipt,
    Rejected,
)
from roadgrip.section import BankOrigin, Direction, build_section
from roadgrip.signing import SIGNED_MORE_BYTES, Claims, Signer
from roadgrip.units import kph_to_mps
from roadgrip.wire import Kind, decode_message, encode_message, kind_of, rounded_to_wire
from tests.roadgrip.wire_samples import (
    ADVISORY,
    BEACON,
    INTERVAL,
    MAP_OFFER,
    PASSAGE,
    PASSAGE_ID,
    RECEIPT,
    SAMPLES,
    SECTION,
    fields_of,
    map_offers,
    messages,
    passages,
    reason_for,
    winding_road,
)

ONE_OF_EACH = {kind_of(message): message for message in SAMPLES.values()}


def reason_with(message: Message, changes: dict[int, Any]) -> Reason:
    """Return why a message is refused when some of its fields are replaced."""
    return reason_for(kind_of(message), cbor2.dumps({**fields_of(message), **changes}, canonical=True))


# What is said arrives.


@given(messages)
def test_a_message_arrives_as_its_rounded_self(message: Message):
    assert decode_message(kind_of(message), encode_message(message)) == rounded_to_wire(message)


@given(messages)
def test_what_was_decoded_encodes_to_the_same_bytes(message: Message):
    payload = encode_message(message)
    assert encode_message(decode_message(kind_of(message), payload)) == payload


@given(messages)
def test_rounding_twice_changes_nothing_more(message: Message):
    once = rounded_to_wire(message)
    assert rounded_to_wire(once) == once


@given(passages)
def test_a_summary_of_32_bit_floats_arrives_exactly(passage: Passage):
    arrived = rounded_to_wire(passage)
    assert arrived.summary.values == passage.summary.values
    assert [math.copysign(1.0, v) for v in arrived.summary.values] == [
        math.copysign(1.0, v) for v in passage.summary.values
    ]


def test_statistics_are_rounded_to_the_nearest_32_bit_float(rng):
    values = tuple(rng.normal(size=55).tolist())
    summary = dataclasses.replace(PASSAGE.summary, values=values)
    arrived = rounded_to_wire(dataclasses.replace(PASSAGE, summary=summary))
    assert arrived.summary.values == tuple(float(np.float32(v)) for v in values)


def test_times_are_rounded_to_ten_milliseconds_and_friction_to_a_ten_thousandth():
    interval = dataclasses.replace(INTERVAL, mu_new=0.123449, newest_age_s=1.2349)
    advisory = dataclasses.replace(ADVISORY.advisory, interval=interval, valid_for_s=59.996)
    arrived = rounded_to_wire(dataclasses.replace(ADVISORY, advisory=advisory)).advisory
    assert arrived.valid_for_s == 60.0
    assert arrived.interval is not None
    assert (arrived.interval.mu_new, arrived.interval.newest_age_s) == (0.1234, 1.23)


@pytest.mark.parametrize("speed_kph", range(5, 135, 5))
def test_an_advised_speed_in_whole_kph_arrives_exactly_and_never_above_the_limit(speed_kph):
    beacon = dataclasses.replace(BEACON, speed_mps=kph_to_mps(speed_kph))
    assert rounded_to_wire(beacon).speed_mps == kph_to_mps(speed_kph)


def test_the_detail_of_a_rejection_is_cut_and_bad_text_is_made_harmless():
    receipt = Receipt(PASSAGE_ID, Rejected(Reason.BUSY, "\ud800\x1b" + "å" * 1000))
    assert rounded_to_wire(receipt).outcome == Rejected(Reason.BUSY, "??" + "å" * 118)


@given(map_offers())
def test_a_map_is_rebuilt_to_the_last_bit(offer: MapOffer):
    arrived = rounded_to_wire(offer)
    assert arrived.section.version == offer.section.version
    assert arrived.section.anchors == offer.section.anchors
    assert arrived.section.origin_m == offer.section.origin_m
    assert np.array_equal(arrived.section.nodes_m, offer.section.nodes_m)
    assert np.array_equal(road_features(arrived.section), road_features(offer.section))


def test_a_summary_for_another_table_is_carried_so_that_it_can_be_refused_by_its_digest():
    summary = KinematicSummary((1.0, 2.0), "00112233445566ff", 3.0)
    passage = dataclasses.replace(PASSAGE, summary=summary)
    assert decode_message(Kind.SUMMARY, encode_message(passage)) == passage


# Size.


def longest_messages() -> list[Message]:
    section_id = "x" * 48
    summary = KinematicSummary((1.0,) * 224, "00112233445566ff", 4e7, QualityFlag(31))
    advisory = Advisory(180.0, AdvisoryReason.FRICTION_INTERVAL, Confidence.RECOMMENDED, INTERVAL, 4e7)
    return [
        Arrival(PASSAGE_ID, section_id, SECTION.version),
        AdvisoryNotice(section_id, SECTION.version, advisory, 2**40),
        Passage(PASSAGE_ID, section_id, SECTION.version, summary, 4e7),
        Receipt(PASSAGE_ID, Rejected(Reason.PASSAGE_ABORTED, "\N{GRINNING FACE}" * 200)),
        Beacon(
            section_id, SECTION.version, 180.0, AdvisoryReason.WINTER_SPEED_NO_MODEL, Confidence.RECOMMENDED, 4e7, 2**40
        ),
    ]


LONGEST_CLAIMS = Claims(2**40, 2**40, "x" * 48, "f" * 16)


def longest_signer(message: Message) -> Signer:
    """Return who may say it, under the longest certificate there is."""
    role = rightful_signer_of(message).certificate.role
    sections = tuple(f"{number}{'x' * 47}" for number in range(8)) if role is Role.UNIT else ()
    return signer_of(role, section_ids=sections, valid_from_unix_s=2**40 - 1, valid_until_unix_s=2**40)


@pytest.mark.parametrize("message", longest_messages(), ids=lambda m: type(m).__name__)
def test_every_message_but_a_map_fits_one_frame_however_long_and_signed(message):
    assert len(encode_message(message, signer=longest_signer(message), claims=LONGEST_CLAIMS)) <= FRAGMENT_BYTES
    assert FRAMES_LIMIT_COUNT[kind_of(message)] == 1


def long_road(nodes_count: int) -> MapOffer:
    """Return the map of a road with a node every 10 m and an anchor every 100 m."""
    section = winding_road(nodes_count, section_id="x" * 48)
    anchors = [
        dataclasses.replace(section.anchors[0], station_m=100.0 * i) for i in range(int(section.length_m / 100) + 1)
    ]
    return MapOffer(dataclasses.replace(section, anchors=tuple(anchors)), (PAPER_TABLE.digest,))


def test_a_map_of_six_kilometres_fits_five_frames_signed():
    payload = encode_message(long_road(630), signer=longest_signer(MAP_OFFER), claims=LONGEST_CLAIMS)
    assert 4 * FRAGMENT_BYTES < len(payload) <= 5 * FRAGMENT_BYTES


@pytest.mark.parametrize("message", [MAP_OFFER, PASSAGE], ids=lambda m: type(m).__name__)
def test_no_signature_costs_more_than_is_said(message):
    signed = encode_message(message, signer=longest_signer(message), claims=LONGEST_CLAIMS)
    assert len(signed) - len(encode_message(message)) <= SIGNED_MORE_BYTES


def test_a_map_that_does_not_fit_is_refused_when_it_is_encoded():
    with pytest.raises(WireError) as caught:
        encode_message(long_road(1000))
    assert caught.value.reason is Reason.OVERSIZED


@pytest.mark.parametrize("kind", Kind)
def test_what_is_too_long_is_refused_before_it_is_read(kind):
    assert reason_for(kind, b"\xa0" * (FRAMES_LIMIT_COUNT[kind] * FRAGMENT_BYTES + 1)) is Reason.OVERSIZED


# What is not a message.

MALFORMED_BYTES = {
    "nothing": b"",
    "no map": cbor2.dumps([1, 2]),
    "a number": b"\x00",
    "text instead of bytes": cbor2.dumps({0: "0123456789abcdef", 1: "road"}, canonical=True),
    "a byte behind": encode_message(SAMPLES["arrival"]) + b"\x00",
    "cut short": encode_message(SAMPLES["arrival"])[:-1],
    "indefinite map": b"\xbf\x00\x50" + PASSAGE_ID + b"\x01\x64road\xff",
    "indefinite text": b"\xa2\x00\x50" + PASSAGE_ID + b"\x01\x7f\x62ro\x62ad\xff",
    "longer integer than needed": b"\xa2\x18\x00\x50" + PASSAGE_ID + b"\x01\x64road",
    "longer length than needed": b"\xa2\x00\x58\x10" + PASSAGE_ID + b"\x01\x64road",
    "keys in the wrong order": b"\xa2\x01\x64road\x00\x50" + PASSAGE_ID,
    "a key twice": b"\xa3\x00\x50" + PASSAGE_ID + b"\x01\x64road\x01\x64toad",
    "keys that are text": cbor2.dumps({"0": PASSAGE_ID, "1": "road"}, canonical=True),
    "an unknown key": cbor2.dumps({0: PASSAGE_ID, 1: "road", 9: 0}, canonical=True),
    "a missing key": cbor2.dumps({0: PASSAGE_ID}, canonical=True),
    "a boolean for a key": cbor2.dumps({False: PASSAGE_ID, 1: "road"}),
    "a float for a key": b"\xa2\x00\x50" + PASSAGE_ID + b"\xf9\x3c\x00\x64road",
    "a simple value for a key": b"\xa2\x00\x50" + PASSAGE_ID + b"\xe1\x64road",
    "a short passage id": cbor2.dumps({0: PASSAGE_ID[:15], 1: "road"}, canonical=True),
    "an empty section id": cbor2.dumps({0: PASSAGE_ID, 1: ""}, canonical=True),
    "a section id in capitals": cbor2.dumps({0: PASSAGE_ID, 1: "Road"}, canonical=True),
    "a path for a section id": cbor2.dumps({0: PASSAGE_ID, 1: "../road"}, canonical=True),
    "a long section id": cbor2.dumps({0: PASSAGE_ID, 1: "r" * 49}, canonical=True),
    "a short digest": cbor2.dumps({0: PASSAGE_ID, 1: "road", 2: b"1234567"}, canonical=True),
    "bad UTF-8": b"\xa2\x00\x50" + PASSAGE_ID + b"\x01\x64ro\xff\xfe",
    "a length beyond the end": b"\xa2\x00\x5b\x7f\xff\xff\xff\xff\xff\xff\xff",
    "a map of exabytes": b"\xbb\xff\xff\xff\xff\xff\xff\xff\xff",
    "deep nesting": b"\x81" * 1300 + b"\x00",
    "deeply nested maps": b"\xa1\x00" * 600 + b"\x00",
    "reserved additional information": b"\x1c",
    "a lone break": b"\xff",
}


@pytest.mark.parametrize("payload", MALFORMED_BYTES.values(), ids=MALFORMED_BYTES.keys())
def test_what_is_no_message_is_malformed(payload):
    assert reason_for(Kind.ARRIVAL, payload) is Reason.MALFORMED


TAGS = [*range(64), 100, 256, 258, 259, 260, 261, 1004, 43000, 55799, 2**32]


@pytest.mark.parametrize("tag", TAGS)
@pytest.mark.parametrize("content", ["2026-01-01T00:00:00Z", 0, b"\x01", [1, 2], "(a+)+$"], ids=str)
def test_no_tag_is_interpreted(tag, content):
    fields = {0: PASSAGE_ID, 1: cbor2.CBORTag(tag, content)}
    assert reason_for(Kind.ARRIVAL, cbor2.dumps(fields)) is Reason.MALFORMED
    assert reason_for(Kind.ARRIVAL, cbor2.dumps(cbor2.CBORTag(tag, content))) is Reason.MALFORMED


@pytest.mark.parametrize("kind", Kind)
@pytest.mark.parametrize("other", Kind)
def test_a_message_never_passes_for_one_of_another_kind(kind, other):
    if kind is not other:
        assert reason_for(other, encode_message(ONE_OF_EACH[kind])) in {Reason.MALFORMED, Reason.OVERSIZED}


@pytest.mark.parametrize("value", [True, None, 1.5, "7", -1.0, cbor2.undefined, [3], float("nan")], ids=repr)
@pytest.mark.parametrize("key", [5, 6, 7])
def test_a_number_is_a_whole_number(key, value):
    assert reason_with(PASSAGE, {key: value}) is Reason.MALFORMED


@pytest.mark.parametrize(
    ("message", "changes", "reason"),
    [
        (PASSAGE, {7: -1}, Reason.IMPOSSIBLE_AGE),
        (PASSAGE, {7: 2**32}, Reason.IMPOSSIBLE_AGE),
        (PASSAGE, {7: 2**70}, Reason.MALFORMED),  # a big number is a tag
        (PASSAGE, {5: -1}, Reason.IMPOSSIBLE_DURATION),
        (PASSAGE, {5: 2**63}, Reason.IMPOSSIBLE_DURATION),
        (PASSAGE, {6: 128}, Reason.OUT_OF_RANGE),
        (BEACON, {2: -1}, Reason.OUT_OF_RANGE),
        (BEACON, {2: 65536}, Reason.OUT_OF_RANGE),
        (BEACON, {3: 6}, Reason.MALFORMED),
        (BEACON, {4: 3}, Reason.MALFORMED),
        (BEACON, {5: -1}, Reason.OUT_OF_RANGE),
        (SAMPLES["arrival"], {3: b"short"}, Reason.MALFORMED),
        (SAMPLES["cookie"], {0: b"much too long"}, Reason.MALFORMED),
        (RECEIPT, {1: 8}, Reason.OUT_OF_RANGE),
        (RECEIPT, {2: 1}, Reason.MALFORMED),  # accepted and rejected at once
        (SAMPLES["receipt-rejected"], {2: 0}, Reason.MALFORMED),
        (SAMPLES["receipt-rejected"], {2: 32}, Reason.MALFORMED),
        (SAMPLES["receipt-rejected"], {3: "x" * 121}, Reason.MALFORMED),
        (SAMPLES["receipt-rejected"], {3: "\x1b[2J"}, Reason.MALFORMED),
        (ADVISORY, {2: -1}, Reason.OUT_OF_RANGE),
        (ADVISORY, {7: [1] * 9}, Reason.MALFORMED),
        (ADVISORY, {7: [1] * 5 + [10_001] + [1] * 4}, Reason.OUT_OF_RANGE),
        (ADVISORY, {7: [65_536] + [1] * 9}, Reason.OUT_OF_RANGE),
        (ADVISORY, {7: [1.0] * 10}, Reason.MALFORMED),
        (MAP_OFFER, {0: "Road"}, Reason.MALFORMED),
        (MAP_OFFER, {1: bytes(8)}, Reason.MALFORMED),  # not the version it says
        (MAP_OFFER, {2: []}, Reason.MALFORMED),
        (MAP_OFFER, {2: [bytes(8)] * 9}, Reason.MALFORMED),
        (MAP_OFFER, {2: [bytes(7)]}, Reason.MALFORMED),
        (MAP_OFFER, {3: "x" * 81}, Reason.MALFORMED),
        (MAP_OFFER, {3: "another name"}, Reason.MALFORMED),
        (MAP_OFFER, {4: 2}, Reason.MALFORMED),
        (MAP_OFFER, {5: "x" * 81}, Reason.MALFORMED),
        (MAP_OFFER, {6: [0, 0]}, Reason.MALFORMED),
        (MAP_OFFER, {6: [0, 0, 10**12]}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {7: [0, 0, 2**31]}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {8: b""}, Reason.MALFORMED),
        (MAP_OFFER, {8: cbor2.CBORTag(77, b"12345")}, Reason.MALFORMED),
        (MAP_OFFER, {8: cbor2.CBORTag(78, bytes(12))}, Reason.MALFORMED),
        (MAP_OFFER, {8: cbor2.CBORTag(77, [1, 2, 3])}, Reason.MALFORMED),
        (MAP_OFFER, {8: cbor2.CBORTag(77, b"")}, Reason.MALFORMED),  # one node, 61 slopes
        (MAP_OFFER, {8: cbor2.CBORTag(77, bytes(6 * 60))}, Reason.OUT_OF_RANGE),  # all nodes in one place
        (MAP_OFFER, {8: cbor2.CBORTag(77, bytes(6 * 1000))}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {8: cbor2.CBORTag(77, struct.pack("<3h", 30_000, 0, 0) * 999)}, Reason.OUT_OF_RANGE),  # 30 km
        (MAP_OFFER, {9: cbor2.CBORTag(77, bytes(2 * 61))}, Reason.MALFORMED),  # zero is said by leaving it out
        (MAP_OFFER, {9: cbor2.CBORTag(77, b"\xff\x7f" * 61)}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {11: 0}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {12: 10_000}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {13: cbor2.CBORTag(78, b"")}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {13: cbor2.CBORTag(78, struct.pack("<3i", -1, 0, 0))}, Reason.OUT_OF_RANGE),
        (MAP_OFFER, {13: cbor2.CBORTag(78, struct.pack("<3i", 0, 900_000_001, 0))}, Reason.OUT_OF_RANGE),
    ],
)
def test_a_field_that_cannot_be_is_refused_with_its_reason(message, changes, reason):
    assert reason_with(message, changes) is reason


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("position", [0, 27, 54])
def test_a_statistic_that_is_not_finite_is_refused(value, position):
    raw = bytearray(fields_of(PASSAGE)[4].value)
    struct.pack_into("<f", raw, 4 * position, value)
    assert reason_with(PASSAGE, {4: cbor2.CBORTag(85, bytes(raw))}) is Reason.NOT_FINITE


@pytest.mark.parametrize("count", [0, 1, 54, 56, 257])
def test_a_summary_has_as_many_statistics_as_its_table(count):
    assert reason_with(PASSAGE, {4: cbor2.CBORTag(85, bytes(4 * count))}) is Reason.MALFORMED


@pytest.mark.parametrize(
    "array", [bytes(220), cbor2.CBORTag(84, bytes(220)), cbor2.CBORTag(85, bytes(219)), [0.0] * 55]
)
def test_the_statistics_are_a_typed_array(array):
    assert reason_with(PASSAGE, {4: array}) is Reason.MALFORMED


# What must not be said.


def with_age(age_s: float) -> Passage:
    return dataclasses.replace(PASSAGE, age_s=age_s)


def with_summary(**changes: Any) -> Passage:
    return dataclasses.replace(PASSAGE, summary=dataclasses.replace(PASSAGE.summary, **changes))


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (with_age(-0.01), Reason.IMPOSSIBLE_AGE),
        (with_age(1e9), Reason.IMPOSSIBLE_AGE),
        (with_age(math.nan), Reason.NOT_FINITE),
        (with_summary(duration_s=-1.0), Reason.IMPOSSIBLE_DURATION),
        (with_summary(duration_s=math.inf), Reason.NOT_FINITE),
        (with_summary(values=(math.nan,) * 55), Reason.NOT_FINITE),
        (with_summary(values=(math.inf, -math.inf) + (0.0,) * 53), Reason.NOT_FINITE),
        (with_summary(values=(1e39,) + (0.0,) * 54), Reason.NOT_FINITE),
        (with_summary(values=(0.0,) * 54), Reason.MALFORMED),
        (with_summary(table_digest="short"), Reason.MALFORMED),
        (with_summary(table_digest="0123456789ABCDEF"), Reason.MALFORMED),
        (dataclasses.replace(PASSAGE, map_version="not hexadecimal."), Reason.MALFORMED),
        (dataclasses.replace(PASSAGE, section_id="Road 7"), Reason.MALFORMED),
        (dataclasses.replace(PASSAGE, passage_id=b"short"), Reason.MALFORMED),
        (dataclasses.replace(BEACON, speed_mps=-1.0), Reason.OUT_OF_RANGE),
        (dataclasses.replace(ADVISORY, issued_unix_s=-5), Reason.OUT_OF_RANGE),
        (dataclasses.replace(MAP_OFFER, table_digests=()), Reason.OUT_OF_RANGE),
        (dataclasses.replace(MAP_OFFER, table_digests=(PAPER_TABLE.digest,) * 9), Reason.OUT_OF_RANGE),
    ],
)
def test_what_no_receiver_would_read_is_not_encoded(message, reason):
    with pytest.raises(WireError) as caught:
        encode_message(message)
    assert caught.value.reason is reason


def test_a_section_that_was_not_built_by_the_rules_is_not_encoded():
    nodes_m = np.array([[0.0, 0.0, 0.0], [40.0, 0.0, 0.0], [80.0, 0.0, 0.0], [120.0, 0.0, 0.0]])
    section = dataclasses.replace(SECTION, nodes_m=nodes_m)
    with pytest.raises(WireError) as caught:
        encode_message(MapOffer(section, (PAPER_TABLE.digest,)))
    assert caught.value.reason is Reason.OUT_OF_RANGE


def test_a_section_far_from_its_origin_keeps_its_place():
    nodes_m = SECTION.nodes_m + np.array([15_000.123, -9_000.0, 77.7])
    section = build_section(section_id="far", name="", nodes_m=nodes_m, speed_limit_mps=20.0)
    assert np.array_equal(rounded_to_wire(MapOffer(section, (PAPER_TABLE.digest,))).section.nodes_m, section.nodes_m)


# The tables of codes.


def test_every_meaning_has_a_code_of_its_own():
    for codes, meanings in (
        (REASON_CODES, Reason),
        (ADVISORY_REASON_CODES, AdvisoryReason),
        (CONFIDENCE_CODES, Confidence),
        (DIRECTION_CODES, Direction),
        (BANK_ORIGIN_CODES, BankOrigin),
    ):
        assert set(codes) == set(meanings)
        assert len(set(codes.values())) == len(codes)


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_arrives(reason):
    receipt = Receipt(PASSAGE_ID, Rejected(reason))
    assert rounded_to_wire(receipt) == receipt


@pytest.mark.parametrize("flags", range(8))
def test_every_way_not_to_be_counted_arrives(flags):
    receipt = Receipt(PASSAGE_ID, Accepted(NotCounted(flags)))
    assert rounded_to_wire(receipt) == receipt


def test_a_receipt_says_nothing_about_the_estimate():
    assert set(fields_of(RECEIPT)) == {0, 1}
