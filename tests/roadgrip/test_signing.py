"""Signatures: what they cover, what is refused without or with a wrong one, and that others make the same."""

import cbor2
import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.errors import ConfigurationError, WireError
from roadgrip.protocol import external_aad_of
from roadgrip.reasons import Reason
from roadgrip.signing import (
    Signer,
    Verifier,
    key_id_of,
    open_payload,
    sign,
    signature_structure,
    signer_from_pem,
    verifier_from_pems,
)
from roadgrip.wire import Kind, decode_message, encode_message, kind_of
from tests.roadgrip.wire_samples import PASSAGE, PRIVATE_KEY, SAMPLES, SIGNER, VERIFIER

OTHER_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))


def reason_of(kind: Kind, payload: bytes, verifier: Verifier | None) -> Reason:
    with pytest.raises(WireError) as caught:
        decode_message(kind, payload, verifier=verifier)
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
    assert PRIVATE_KEY.sign(structure) == signature


def test_a_signed_message_is_what_the_rfc_says_byte_by_byte():
    key_id = b"12345678"
    protected = b"\xa2\x01\x27\x04\x48" + key_id
    payload = b"\xa0"
    external = b"roadgrip/1/BEACON"
    structure = b"\x84\x6aSignature1" + b"\x4d" + protected + b"\x51" + external + b"\x41" + payload
    expected = b"\xd2\x84\x4d" + protected + b"\xa0" + b"\x41" + payload + b"\x58\x40" + PRIVATE_KEY.sign(structure)
    assert external_aad_of(Kind.BEACON, exchange_id=bytes(8)) == external
    assert sign(payload, signer=Signer(key_id, PRIVATE_KEY), external_aad=external) == expected


# Every kind, with and without.


@pytest.mark.parametrize("name", SAMPLES)
def test_every_message_can_be_signed_and_read(name):
    message = SAMPLES[name]
    signed = encode_message(message, signer=SIGNER)
    plain = decode_message(kind_of(message), encode_message(message))
    assert decode_message(kind_of(message), signed, verifier=VERIFIER) == plain
    assert decode_message(kind_of(message), signed) == plain


@pytest.mark.parametrize("name", SAMPLES)
def test_an_unsigned_message_is_refused_where_signatures_are_required_only(name):
    message = SAMPLES[name]
    payload = encode_message(message)
    assert reason_of(kind_of(message), payload, VERIFIER) is Reason.UNSIGNED
    decode_message(kind_of(message), payload, verifier=Verifier(VERIFIER.public_keys, required=False))


@pytest.mark.parametrize("required", [True, False])
def test_a_key_that_is_not_known_is_refused_also_where_signatures_are_optional(required):
    signed = encode_message(PASSAGE, signer=Signer(b"stranger", OTHER_KEY))
    assert reason_of(Kind.SUMMARY, signed, Verifier(VERIFIER.public_keys, required=required)) is Reason.UNKNOWN_KEY


@pytest.mark.parametrize("required", [True, False])
def test_a_known_id_with_another_key_is_a_bad_signature(required):
    signed = encode_message(PASSAGE, signer=Signer(SIGNER.key_id, OTHER_KEY))
    assert reason_of(Kind.SUMMARY, signed, Verifier(VERIFIER.public_keys, required=required)) is Reason.BAD_SIGNATURE


def test_a_signature_for_one_kind_does_not_hold_for_another():
    payload = encode_message(SAMPLES["beacon"])
    signed = sign(payload, signer=SIGNER, external_aad=external_aad_of(Kind.ARRIVAL, exchange_id=b""))
    assert reason_of(Kind.BEACON, signed, VERIFIER) is Reason.BAD_SIGNATURE


def test_an_advisory_that_is_played_again_in_another_exchange_does_not_verify():
    recorded = encode_message(SAMPLES["advisory"], signer=SIGNER, exchange_id=b"earlier.")
    assert decode_message(Kind.ADVISORY, recorded, verifier=VERIFIER, exchange_id=b"earlier.") == SAMPLES["advisory"]
    with pytest.raises(WireError) as caught:
        decode_message(Kind.ADVISORY, recorded, verifier=VERIFIER, exchange_id=b"just now")
    assert caught.value.reason is Reason.BAD_SIGNATURE


def test_a_signature_covers_the_statistics():
    signed = bytearray(encode_message(PASSAGE, signer=SIGNER))
    signed[150] ^= 1
    assert reason_of(Kind.SUMMARY, bytes(signed), VERIFIER) is Reason.BAD_SIGNATURE


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_no_changed_byte_is_believed(position, change):
    signed = bytearray(encode_message(SAMPLES["beacon"], signer=SIGNER))
    signed[position % len(signed)] ^= change
    assert reason_of(Kind.BEACON, bytes(signed), VERIFIER) in {
        Reason.BAD_SIGNATURE,
        Reason.UNKNOWN_KEY,
        Reason.UNSIGNED,
        Reason.MALFORMED,
    }


PROTECTED = cbor2.dumps({1: -8, 4: SIGNER.key_id}, canonical=True)


@pytest.mark.parametrize(
    "parts",
    [
        [PROTECTED, {}, None, bytes(64)],
        [PROTECTED, {}, b"\xa0"],
        [PROTECTED, {}, b"\xa0", bytes(64), 0],
        [PROTECTED, {4: SIGNER.key_id}, b"\xa0", bytes(64)],
        [PROTECTED, {}, b"\xa0", bytes(63)],
        [PROTECTED, [], b"\xa0", bytes(64)],
        [b"", {4: SIGNER.key_id}, b"\xa0", bytes(64)],
        [cbor2.dumps({1: -7, 4: SIGNER.key_id}), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({1: -8}), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({1: -8, 4: b""}), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({1: -8, 4: bytes(33)}), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({1: -8, 4: "text"}), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({1: -8, 2: [4], 4: SIGNER.key_id}), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({1: -8.0, 4: SIGNER.key_id}, canonical=True), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({True: -8, 4: SIGNER.key_id}), {}, b"\xa0", bytes(64)],
        [cbor2.dumps({4: SIGNER.key_id, 1: -8}), {}, b"\xa0", bytes(64)],
        [PROTECTED + b"\x00", {}, b"\xa0", bytes(64)],
    ],
    ids=repr,
)
@pytest.mark.parametrize("verifier", [VERIFIER, None])
def test_what_begins_like_a_signed_message_and_is_none_is_malformed(parts, verifier):
    assert reason_of(Kind.BEACON, cbor2.dumps(cbor2.CBORTag(18, parts)), verifier) is Reason.MALFORMED


def test_a_signed_message_inside_a_signed_message_is_malformed():
    inner = encode_message(SAMPLES["beacon"], signer=SIGNER)
    outer = sign(inner, signer=SIGNER, external_aad=external_aad_of(Kind.BEACON, exchange_id=b""))
    assert reason_of(Kind.BEACON, outer, VERIFIER) is Reason.MALFORMED


def test_an_empty_message_is_left_to_whoever_reads_it():
    assert open_payload(b"", verifier=None, external_aad=b"") == b""


# Keys.


def pem_of(key: Ed25519PrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def public_pem_of(key: Ed25519PrivateKey) -> bytes:
    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)


def test_keys_come_from_pem_and_fit_each_other():
    signer = signer_from_pem(pem_of(OTHER_KEY))
    verifier = verifier_from_pems([public_pem_of(PRIVATE_KEY), public_pem_of(OTHER_KEY)], required=True)
    assert signer.key_id == key_id_of(OTHER_KEY.public_key())
    assert decode_message(Kind.SUMMARY, encode_message(PASSAGE, signer=signer), verifier=verifier) == PASSAGE


@pytest.mark.parametrize("pem", [b"", b"not a key", public_pem_of(OTHER_KEY)])
def test_what_is_no_private_key_is_a_configuration_error(pem):
    with pytest.raises(ConfigurationError):
        signer_from_pem(pem)


def test_a_key_of_another_algorithm_is_a_configuration_error():
    key = generate_private_key(SECP256R1())
    with pytest.raises(ConfigurationError, match="Ed25519"):
        signer_from_pem(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    with pytest.raises(ConfigurationError, match="Ed25519"):
        verifier_from_pems(
            [key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)], required=False
        )


@pytest.mark.parametrize("pem", [b"", b"not a key", pem_of(OTHER_KEY)])
def test_what_is_no_public_key_is_a_configuration_error(pem):
    with pytest.raises(ConfigurationError):
        verifier_from_pems([pem], required=False)


def test_requiring_signatures_without_a_key_is_a_configuration_error():
    with pytest.raises(ConfigurationError):
        verifier_from_pems([], required=True)
