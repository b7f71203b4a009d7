"""The published schema and the code say the same, judged by somebody else's CDDL implementation."""

from pathlib import Path
from typing import Any

import cbor2
import pytest
from hypothesis import given, settings

from bench.certified import AUTHORITY_KEY, NOW_UNIX_S, UNIT, VEHICLE, claims_for, rightful_signer_of, signer_of
from roadgrip.certificates import RevocationList, Role, issue_revocations
from roadgrip.records import Accepted, Message, Receipt
from roadgrip.wire import Kind, encode_message, kind_of
from tests.roadgrip.wire_samples import PASSAGE, RECEIPT, SAMPLES, SECTION, map_offers, messages

# Its makers publish no wheel for Linux on aarch64.
pycddl = pytest.importorskip("pycddl")

SCHEMA_TEXT = (Path(__file__).resolve().parents[2] / "docs" / "wire.cddl").read_text(encoding="utf-8")
RULES = ("arrival", "map", "advisory", "summary", "receipt-accepted", "receipt-rejected", "beacon", "cookie")


def schema(rule: str) -> Any:
    """Return the schema with another rule as its root, which is the first one."""
    return pycddl.Schema(f"start = {rule}\n{SCHEMA_TEXT}")


PARTS = (
    "wire-message",
    "signed-message",
    "protected-header",
    "certificate",
    "authority-header",
    "certificate-claims",
    "revocations",
    "revocation-list",
)
SCHEMAS = {rule: schema(rule) for rule in (*RULES, *PARTS)}


def rule_of(message: Message) -> str:
    if isinstance(message, Receipt):
        return "receipt-accepted" if isinstance(message.outcome, Accepted) else "receipt-rejected"
    return kind_of(message).name.lower()


@settings(max_examples=50)
@given(messages)
def test_every_message_is_as_the_schema_says(message):
    SCHEMAS[rule_of(message)].validate_cbor(encode_message(message))


@settings(max_examples=20)
@given(map_offers())
def test_every_map_is_as_the_schema_says(offer):
    SCHEMAS["map"].validate_cbor(encode_message(offer))


@pytest.mark.parametrize("name", SAMPLES)
def test_a_message_fits_its_own_rule_only(name):
    payload = encode_message(SAMPLES[name])
    SCHEMAS["wire-message"].validate_cbor(payload)
    for rule in RULES:
        if rule != rule_of(SAMPLES[name]):
            with pytest.raises(pycddl.ValidationError):
                SCHEMAS[rule].validate_cbor(payload)


@pytest.mark.parametrize("name", [name for name in SAMPLES if name != "cookie"])
def test_a_signed_message_is_as_the_schema_says_inside_and_outside(name):
    message = SAMPLES[name]
    claims = claims_for(message, section_id=SECTION.section_id, map_version=SECTION.version)
    signed = encode_message(message, signer=rightful_signer_of(message), claims=claims)
    SCHEMAS["signed-message"].validate_cbor(signed)
    SCHEMAS["wire-message"].validate_cbor(signed)
    protected, unprotected, payload, _ = cbor2.loads(signed).value
    SCHEMAS["protected-header"].validate_cbor(protected)
    SCHEMAS[rule_of(message)].validate_cbor(payload)
    SCHEMAS["certificate"].validate_cbor(cbor2.dumps(unprotected[13], canonical=True))


@pytest.mark.parametrize("signer", [UNIT, VEHICLE, signer_of(Role.UNIT, section_ids=("a", "b-2"))])
def test_a_certificate_is_as_the_schema_says_inside(signer):
    protected, _, payload, _ = cbor2.loads(signer.certificate.encoded).value
    SCHEMAS["authority-header"].validate_cbor(protected)
    SCHEMAS["certificate-claims"].validate_cbor(payload)


@pytest.mark.parametrize("ids", [frozenset(), frozenset({b"12345678", b"abcdefgh"})])
def test_a_list_of_revoked_certificates_is_as_the_schema_says(ids):
    encoded = issue_revocations(RevocationList(NOW_UNIX_S, NOW_UNIX_S + 1, ids), authority=AUTHORITY_KEY)
    SCHEMAS["revocations"].validate_cbor(encoded)
    protected, _, payload, _ = cbor2.loads(encoded).value
    SCHEMAS["authority-header"].validate_cbor(protected)
    SCHEMAS["revocation-list"].validate_cbor(payload)


@pytest.mark.parametrize(
    ("message", "changes"),
    [(PASSAGE, {0: b"short"}), (PASSAGE, {1: "ROAD"}), (PASSAGE, {5: -1}), (PASSAGE, {9: 0}), (RECEIPT, {1: 8})],
)
def test_the_schema_refuses_what_the_code_refuses(message, changes):
    fields = {**cbor2.loads(encode_message(message)), **changes}
    with pytest.raises(pycddl.ValidationError):
        SCHEMAS[rule_of(message)].validate_cbor(cbor2.dumps(fields, canonical=True))


def test_the_schema_has_a_rule_for_every_kind():
    for kind in Kind:
        schema(kind.name.lower())
