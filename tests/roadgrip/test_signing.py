"""Signatures: what they cover, what is refused without or with a wrong one, and that others make the same."""

import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.certified import (
    AUTHORITIES,
    AUTHORITY_KEY,
    NOW_UNIX_S,
    OTHER_AUTHORITY_KEY,
    UNIT,
    UNIT_KEY,
    VEHICLE,
    VERIFIER,
    claims_for,
    rightful_signer_of,
    signer_of,
)
from roadgrip.certificates import RevocationList, Role
from roadgrip.errors import WireError
from roadgrip.protocol import external_aad_of
from roadgrip.reasons import Reason
from roadgrip.sign1 import sealed, sign1_in, signature_structure
from roadgrip.signing import Claims, Signer, Verifier, authorities_of, open_payload, sign
from roadgrip.wire import Kind, decode_message, encode_message, kind_of, open_message
from tests.roadgrip.wire_samples import PASSAGE, SAMPLES, SECTION

SIGNED_NAMES = [name for name in SAMPLES if name != "cookie"]
BEACON = SAMPLES["beacon"]
BEACON_AAD = external_aad_of(Kind.BEACON, exchange_id=b"")


def signed(name: str, *, signer: Signer | None = None, exchange_id: bytes = b"") -> bytes:
    message = SAMPLES[name]
    claims = claims_for(message, section_id=SECTION.section_id, map_version=SECTION.version)
    return encode_message(message, signer=signer or rightful_signer_of(message), exchange_id=exchange_id, claims=claims)


def reason_of(kind: Kind, payload: bytes, verifier: Verifier | None = VERIFIER, *, required: bool = True) -> Reason:
    with pytest.raises(WireError) as caught:
        open_message(kind, payload, verifier=verifier, required=required)
    return caught.value.reason


# What others publish and what RFC 9052 says, built by hand.


def test_the_published_example_of_the_cose_working_group_comes_out():
    # cose-wg/Examples, eddsa-examples/eddsa-sig-01.json; its key is the first test key of RFC 8032.
    to_be_signed = bytes.fromhex("846A5369676E61747572653145A2012703004054546869732069732074686520636F6E74656E742E")
    signature = bytes.fromhex(
        "7142FD2FF96D56DB85BEE905A76BA1D0B7321A95C8C4D3607C5781932B7AFB87"
        "11497DFA751BF40B58B3BCC32300B1487F3DB34085EEF013BF08F4A44D6FEF0D"
    )
    structure = signature_structure(
        protected=bytes.fromhex("A201270300"), external_aad=b"", payload=b"This is the content."
    )
    assert structure == to_be_signed
    assert AUTHORITY_KEY.sign(structure) == signature


def test_a_signed_message_is_what_the_rfcs_say_byte_by_byte():
    certificate = UNIT.certificate.encoded
    claims = b"\xa4" + b"\x02\x64bend" + b"\x04\x1a\x65\x00\x01\x00" + b"\x06\x1a\x65\x00\x00\x00"
    claims += b"\x3a\x00\x01\x11\x70\x48" + bytes.fromhex("00112233445566ff")
    protected = b"\xa3\x01\x27\x04\x48" + UNIT.certificate.certificate_id + b"\x0f" + claims
    payload, external = b"\xa0", b"roadgrip/1/BEACON"
    structure = b"\x84\x6aSignature1" + b"\x58" + bytes([len(protected)]) + protected + b"\x51" + external + b"\x41\xa0"
    expected = b"\xd2\x84\x58" + bytes([len(protected)]) + protected + b"\xa1\x0d" + certificate + b"\x41\xa0"
    expected += b"\x58\x40" + UNIT_KEY.sign(structure)
    said = Claims(0x65000000, 0x65000100, "bend", "00112233445566ff")
    assert sign(payload, signer=UNIT, external_aad=external, claims=said) == expected
    assert external == BEACON_AAD


@pytest.mark.parametrize("name", SIGNED_NAMES)
def test_another_library_reads_the_same_envelope(name):
    envelope = cbor2.loads(signed(name))
    assert envelope.tag == 18
    protected, unprotected, payload, signature = envelope.value
    signer = rightful_signer_of(SAMPLES[name])
    assert cbor2.dumps(unprotected[13], canonical=True) == signer.certificate.encoded
    structure = cbor2.dumps(
        ["Signature1", protected, external_aad_of(kind_of(SAMPLES[name]), exchange_id=b""), payload], canonical=True
    )
    signer.private_key.public_key().verify(signature, structure)


# Every kind, with and without.


@pytest.mark.parametrize("name", SIGNED_NAMES)
def test_every_message_can_be_signed_and_read(name):
    message = SAMPLES[name]
    plain = decode_message(kind_of(message), encode_message(message))
    received = open_message(kind_of(message), signed(name), verifier=VERIFIER, required=True)
    assert received.message == plain
    assert received.signed is not None
    assert received.signed.certificate == rightful_signer_of(message).certificate
    assert received.signed.claims == claims_for(message, section_id=SECTION.section_id, map_version=SECTION.version)
    assert decode_message(kind_of(message), signed(name)) == plain


@pytest.mark.parametrize("name", SIGNED_NAMES)
def test_an_unsigned_message_is_refused_where_signatures_are_required_only(name):
    message = SAMPLES[name]
    payload = encode_message(message)
    assert reason_of(kind_of(message), payload) is Reason.UNSIGNED
    assert open_message(kind_of(message), payload, verifier=VERIFIER).signed is None


def test_a_cookie_is_never_signed_and_never_asked_to_be():
    payload = encode_message(SAMPLES["cookie"], signer=UNIT)
    assert payload == encode_message(SAMPLES["cookie"])
    assert open_message(Kind.COOKIE, payload, verifier=VERIFIER, required=True).message == SAMPLES["cookie"]
    assert reason_of(Kind.COOKIE, sign(payload, signer=UNIT, external_aad=b"")) is Reason.MALFORMED


@pytest.mark.parametrize("required", [True, False])
def test_an_authority_that_is_not_trusted_is_refused_also_where_signatures_are_optional(required):
    stranger = signer_of(Role.VEHICLE, authority=OTHER_AUTHORITY_KEY)
    assert reason_of(Kind.SUMMARY, signed("summary", signer=stranger), required=required) is Reason.UNKNOWN_KEY


def test_who_certifies_himself_is_no_authority():
    himself = signer_of(Role.VEHICLE, private_key=OTHER_AUTHORITY_KEY, authority=OTHER_AUTHORITY_KEY)
    assert reason_of(Kind.SUMMARY, signed("summary", signer=himself)) is Reason.UNKNOWN_KEY


def test_a_certificate_of_somebody_else_does_not_help_a_key_without_one():
    thief = Signer(VEHICLE.certificate, OTHER_AUTHORITY_KEY)
    assert reason_of(Kind.SUMMARY, signed("summary", signer=thief), required=False) is Reason.BAD_SIGNATURE


def test_a_forged_certificate_under_the_name_of_a_trusted_authority_is_a_bad_signature():
    forged = signer_of(Role.VEHICLE, authority=OTHER_AUTHORITY_KEY).certificate.encoded
    renamed = forged.replace(next(iter(authorities_of([OTHER_AUTHORITY_KEY.public_key()]))), next(iter(AUTHORITIES)))
    payload = signed("summary").replace(VEHICLE.certificate.encoded, renamed)
    assert reason_of(Kind.SUMMARY, payload) is Reason.BAD_SIGNATURE


def test_a_signature_for_one_kind_does_not_hold_for_another():
    aad = external_aad_of(Kind.ARRIVAL, exchange_id=b"")
    assert reason_of(Kind.BEACON, sign(encode_message(BEACON), signer=UNIT, external_aad=aad)) is Reason.BAD_SIGNATURE


def test_an_advisory_that_is_played_again_in_another_exchange_does_not_verify():
    recorded = signed("advisory", exchange_id=b"earlier.")
    read = open_message(Kind.ADVISORY, recorded, verifier=VERIFIER, required=True, exchange_id=b"earlier.")
    assert read.message == SAMPLES["advisory"]
    with pytest.raises(WireError) as caught:
        open_message(Kind.ADVISORY, recorded, verifier=VERIFIER, required=True, exchange_id=b"just now")
    assert caught.value.reason is Reason.BAD_SIGNATURE


def test_a_signature_covers_the_claims():
    later = signed("beacon").replace((NOW_UNIX_S).to_bytes(4, "big"), (NOW_UNIX_S + 9).to_bytes(4, "big"))
    assert reason_of(Kind.BEACON, later) is Reason.BAD_SIGNATURE


@pytest.mark.parametrize("name", ["arrival", "advisory", "receipt-accepted", "beacon"])
@given(position=st.integers(0, 10**6), bit=st.integers(0, 7))
def test_a_message_with_any_bit_changed_is_refused(name, position, bit):
    changed = bytearray(signed(name))
    changed[position % len(changed)] ^= 1 << bit
    assert reason_of(kind_of(SAMPLES[name]), bytes(changed)) in {
        Reason.BAD_SIGNATURE,
        Reason.UNKNOWN_KEY,
        Reason.UNSIGNED,
        Reason.MALFORMED,
        Reason.OUT_OF_RANGE,
    }


times = st.one_of(st.none(), st.integers(0, 2**40))


@given(
    times,
    times,
    st.one_of(st.just(""), st.text("abcdefghijklmnopqrstuvwxyz0123456789-", min_size=1, max_size=48)),
    st.one_of(st.just(""), st.binary(min_size=8, max_size=8).map(bytes.hex)),
    st.binary(max_size=2000),
)
def test_claims_and_payload_come_back_as_they_were_signed(issued, expires, section_id, map_version, payload):
    claims = Claims(issued, expires, section_id, map_version)
    opened, said = VERIFIER.unsealed(sign(payload, signer=UNIT, external_aad=b"x", claims=claims), external_aad=b"x")
    assert (opened, said.claims) == (payload, claims)


@given(st.one_of(st.integers(0, 2**33), st.integers(2**16 - 2, 2**16 + 2), st.integers(2**32 - 2, 2**32 + 2)))
def test_the_usual_header_of_a_vehicle_reads_like_any_other(issued_unix_s):
    claims = Claims(issued_unix_s=issued_unix_s)
    protected = sign1_in(sign(b"", signer=VEHICLE, external_aad=b"", claims=claims)).protected
    as_any_other = cbor2.loads(protected)
    assert (as_any_other[4], as_any_other[15]) == (VEHICLE.certificate.certificate_id, {6: issued_unix_s})
    _, said = VERIFIER.unsealed(sign(b"", signer=VEHICLE, external_aad=b"", claims=claims), external_aad=b"")
    assert said == (VEHICLE.certificate, claims)


def test_a_time_in_more_bytes_than_it_needs_is_malformed():
    protected = b"\xa3\x01\x27\x04\x48" + UNIT.certificate.certificate_id + b"\x0f\xa1\x06\x1a\0\0\xff\xff"
    data = sealed(
        encode_message(BEACON),
        private_key=UNIT_KEY,
        protected=protected,
        external_aad=BEACON_AAD,
        certificate=UNIT.certificate.encoded,
    )
    assert reason_of(Kind.BEACON, data) is Reason.MALFORMED


# What is no signed message.


PROTECTED = cbor2.dumps({1: -8, 4: UNIT.certificate.certificate_id}, canonical=True)
CERTIFICATE = cbor2.loads(UNIT.certificate.encoded)
KCWT = {13: CERTIFICATE}


def test_the_parts_of_the_next_test_would_be_a_signed_message():
    data = cbor2.dumps(cbor2.CBORTag(18, [PROTECTED, KCWT, b"\xa0", bytes(64)]), canonical=True)
    assert open_payload(data, verifier=None, required=False, external_aad=b"") == (b"\xa0", None)


@pytest.mark.parametrize(
    "parts",
    [
        [PROTECTED, KCWT, None, bytes(64)],
        [PROTECTED, KCWT, b"\xa0"],
        [PROTECTED, KCWT, b"\xa0", bytes(64), 0],
        [PROTECTED, {4: b"12345678"}, b"\xa0", bytes(64)],
        [PROTECTED, {13: b"1234"}, b"\xa0", bytes(64)],
        [PROTECTED, {13: CERTIFICATE.value}, b"\xa0", bytes(64)],
        [PROTECTED, {13: cbor2.CBORTag(18, [PROTECTED, KCWT, b"", bytes(64)])}, b"\xa0", bytes(64)],
        [PROTECTED, KCWT | {14: 0}, b"\xa0", bytes(64)],
        [PROTECTED, KCWT, b"\xa0", bytes(63)],
        [PROTECTED, [], b"\xa0", bytes(64)],
        [[], KCWT, b"\xa0", bytes(64)],
    ],
    ids=lambda parts: str(len(str(parts))),
)
@pytest.mark.parametrize("verifier", [VERIFIER, None])
def test_what_begins_like_a_signed_message_and_is_none_is_malformed(parts, verifier):
    data = cbor2.dumps(cbor2.CBORTag(18, parts), canonical=True)
    assert reason_of(Kind.BEACON, data, verifier, required=False) is Reason.MALFORMED


@pytest.mark.parametrize(
    "header",
    [
        {1: -7, 4: UNIT.certificate.certificate_id},
        {1: -8},
        {1: -8, 4: b""},
        {1: -8, 4: b"another."},
        {1: -8, 4: "text"},
        {1: -8, 2: [4], 4: UNIT.certificate.certificate_id},
        {1: -8.0, 4: UNIT.certificate.certificate_id},
        {True: -8, 4: UNIT.certificate.certificate_id},
        {1: -8, 4: UNIT.certificate.certificate_id, 15: {}},
        {1: -8, 4: UNIT.certificate.certificate_id, 15: {1: "issuer"}},
        {1: -8, 4: UNIT.certificate.certificate_id, 15: {2: "Bend"}},
        {1: -8, 4: UNIT.certificate.certificate_id, 15: {6: 1.0}},
        {1: -8, 4: UNIT.certificate.certificate_id, 15: {-70001: b"short"}},
        [],
    ],
    ids=repr,
)
def test_a_header_that_is_not_ours_is_malformed_however_well_signed(header):
    data = sealed(
        encode_message(BEACON),
        private_key=UNIT_KEY,
        protected=cbor2.dumps(header, canonical=True),
        external_aad=BEACON_AAD,
        certificate=UNIT.certificate.encoded,
    )
    assert reason_of(Kind.BEACON, data) is Reason.MALFORMED


def test_a_message_without_the_certificate_of_its_signer_is_malformed():
    data = sealed(encode_message(BEACON), private_key=UNIT_KEY, protected=PROTECTED, external_aad=BEACON_AAD)
    assert reason_of(Kind.BEACON, data) is Reason.MALFORMED


def test_a_signed_message_inside_a_signed_message_is_malformed():
    outer = sign(signed("beacon"), signer=UNIT, external_aad=BEACON_AAD)
    assert reason_of(Kind.BEACON, outer) is Reason.MALFORMED


def test_an_empty_message_is_left_to_whoever_reads_it():
    assert open_payload(b"", verifier=None, required=False, external_aad=b"") == (b"", None)


def test_a_receiver_that_asks_for_signatures_and_trusts_nobody_believes_nobody():
    assert reason_of(Kind.BEACON, signed("beacon"), None) is Reason.UNKNOWN_KEY


# What a verifier remembers.


def test_a_revoked_certificate_is_refused_although_it_was_good_before():
    revoked = RevocationList(NOW_UNIX_S, NOW_UNIX_S + 1, frozenset({VEHICLE.certificate.certificate_id}))
    assert reason_of(Kind.SUMMARY, signed("summary"), Verifier(AUTHORITIES, revocations=revoked)) is (
        Reason.CERTIFICATE_REVOKED
    )


def test_only_certificates_that_an_authority_has_signed_are_remembered():
    verifier = Verifier(AUTHORITIES)
    reason_of(Kind.SUMMARY, signed("summary", signer=signer_of(Role.VEHICLE, authority=OTHER_AUTHORITY_KEY)), verifier)
    assert verifier.known_count == 0


def test_the_memory_of_certificates_is_bounded():
    verifier = Verifier(AUTHORITIES, known_limit_count=3)
    for number in range(10):
        car = signer_of(Role.VEHICLE, certificate_id=number.to_bytes(8, "big"))
        open_message(Kind.SUMMARY, encode_message(PASSAGE, signer=car), verifier=verifier)
    assert verifier.known_count == 3


def test_a_remembered_certificate_still_checks_every_message():
    verifier = Verifier(AUTHORITIES)
    open_message(Kind.SUMMARY, signed("summary"), verifier=verifier, required=True)
    changed = bytearray(signed("summary"))
    changed[-70] ^= 1
    assert reason_of(Kind.SUMMARY, bytes(changed), verifier) is Reason.BAD_SIGNATURE
