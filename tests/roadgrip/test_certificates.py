"""Certificates and lists of revoked ones: they come back as they were issued, and nothing else is one."""

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
    signer_of,
)
from roadgrip.certificates import (
    REVOCATIONS_LIMIT_COUNT,
    SCOPE_LIMIT_CHARS,
    RevocationList,
    Role,
    certificate_in_pem,
    certificate_to_pem,
    check_certificate,
    issue_certificate,
    issue_revocations,
    read_certificate,
    read_revocations,
)
from roadgrip.errors import ConfigurationError, WireError
from roadgrip.reasons import Reason
from roadgrip.sign1 import external_aad_for, key_id_of, sealed

HEADER = {1: -8, 4: key_id_of(AUTHORITY_KEY.public_key())}
CLAIMS = cbor2.loads(cbor2.loads(UNIT.certificate.encoded).value[2])
section_ids = st.text("abcdefghijklmnopqrstuvwxyz0123456789-", min_size=1, max_size=48)


def encoded(claims: object, header: object = HEADER, *, purpose: str = "CERTIFICATE") -> bytes:
    return sealed(
        cbor2.dumps(claims, canonical=True),
        private_key=AUTHORITY_KEY,
        protected=cbor2.dumps(header, canonical=True),
        external_aad=external_aad_for(purpose),
    )


@given(
    st.sampled_from(Role),
    st.lists(section_ids, max_size=7),
    st.lists(st.integers(0, 2**40), min_size=2, max_size=2).map(sorted),
    st.binary(min_size=8, max_size=8),
)
def test_a_certificate_comes_back_as_it_was_issued(role, sections, dates, certificate_id):
    wanted = tuple(sections) if role is Role.UNIT else ()
    issued = issue_certificate(
        UNIT_KEY.public_key().public_bytes_raw(),
        authority=AUTHORITY_KEY,
        certificate_id=certificate_id,
        role=role,
        section_ids=wanted,
        valid_from_unix_s=dates[0],
        valid_until_unix_s=dates[1],
    )
    read = read_certificate(issued.encoded)
    check_certificate(read, AUTHORITIES)
    assert read == issued
    assert (read.role, set(read.section_ids), read.certificate_id) == (role, set(wanted), certificate_id)
    assert (read.valid_from_unix_s, read.valid_until_unix_s) == tuple(dates)
    assert certificate_in_pem(certificate_to_pem(read)) == read


@given(st.integers(0, 10**6), st.integers(0, 7))
def test_a_certificate_with_any_bit_changed_is_refused(position, bit):
    changed = bytearray(UNIT.certificate.encoded)
    changed[position % len(changed)] ^= 1 << bit
    with pytest.raises(WireError):
        check_certificate(read_certificate(bytes(changed)), AUTHORITIES)


def test_the_claims_of_the_next_test_would_be_a_certificate():
    assert encoded(CLAIMS) == UNIT.certificate.encoded


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({4: NOW_UNIX_S, 5: NOW_UNIX_S + 1}, Reason.OUT_OF_RANGE),
        ({4: -1}, Reason.OUT_OF_RANGE),
        ({4: 1.5}, Reason.MALFORMED),
        ({7: b"short"}, Reason.MALFORMED),
        ({8: {1: {1: 1, -1: 6, -2: bytes(31)}}}, Reason.MALFORMED),
        ({8: {1: {1: 1, -1: 4, -2: bytes(32)}}}, Reason.MALFORMED),
        ({8: {1: {1: 2, -1: 6, -2: bytes(32)}}}, Reason.MALFORMED),
        ({8: {1: {1: 1, -1: 6, -2: bytes(32), -4: bytes(32)}}}, Reason.MALFORMED),
        ({8: {3: b"kid"}}, Reason.MALFORMED),
        ({9: "vehicle unit"}, Reason.MALFORMED),
        ({9: "vehicle:bend"}, Reason.MALFORMED),
        ({9: "unit:"}, Reason.MALFORMED),
        ({9: "unit:Bend"}, Reason.MALFORMED),
        ({9: "unit:b a"}, Reason.MALFORMED),
        ({9: "unit:a a"}, Reason.MALFORMED),
        ({9: "unit:a  b"}, Reason.MALFORMED),
        ({9: "unit:" + "a" * SCOPE_LIMIT_CHARS}, Reason.MALFORMED),
        ({9: b"unit"}, Reason.MALFORMED),
        ({1: "issuer"}, Reason.MALFORMED),
    ],
    ids=repr,
)
def test_claims_that_are_not_ours_are_no_certificate_however_well_signed(changes, reason):
    with pytest.raises(WireError) as caught:
        read_certificate(encoded(CLAIMS | changes))
    assert caught.value.reason is reason


@pytest.mark.parametrize("header", [{1: -8}, {1: -7, 4: bytes(8)}, {1: -8, 4: bytes(7)}, {1: -8, 4: bytes(8), 5: 0}, 1])
def test_a_header_that_is_not_an_authoritys_is_no_certificate(header):
    with pytest.raises(WireError) as caught:
        read_certificate(encoded(CLAIMS, header))
    assert caught.value.reason is Reason.MALFORMED


@pytest.mark.parametrize("purpose", ["REVOCATIONS", "SUMMARY"])
def test_what_was_signed_for_another_purpose_is_no_certificate(purpose):
    with pytest.raises(WireError) as caught:
        check_certificate(read_certificate(encoded(CLAIMS, purpose=purpose)), AUTHORITIES)
    assert caught.value.reason is Reason.BAD_SIGNATURE


def test_a_certificate_certifies_nobody_else():
    chained = signer_of(Role.VEHICLE, authority=UNIT_KEY).certificate
    with pytest.raises(WireError) as caught:
        check_certificate(chained, AUTHORITIES)
    assert caught.value.reason is Reason.UNKNOWN_KEY


def test_a_vehicle_has_no_sections():
    with pytest.raises(WireError):
        signer_of(Role.VEHICLE, section_ids=("bend",))


@pytest.mark.parametrize(
    ("certificate", "bend", "elsewhere"),
    [
        (UNIT.certificate, True, True),
        (signer_of(Role.UNIT, section_ids=("bend",)).certificate, True, False),
        (VEHICLE.certificate, False, False),
    ],
)
def test_whom_a_certificate_lets_speak_for_which_section(certificate, bend, elsewhere):
    assert (certificate.speaks_for("bend"), certificate.speaks_for("elsewhere")) == (bend, elsewhere)


# PEM.


@pytest.mark.parametrize(
    "pem",
    [
        b"",
        certificate_to_pem(UNIT.certificate) * 2,
        certificate_to_pem(UNIT.certificate)[:100] + b"\n-----END ROADGRIP CERTIFICATE-----",
        certificate_to_pem(UNIT.certificate).replace(b"A", b"!"),
    ],
    ids=["none", "two", "cut", "not base64"],
)
def test_what_holds_no_certificate_in_pem_is_a_configuration_error(pem):
    with pytest.raises(ConfigurationError):
        certificate_in_pem(pem)


# Lists of revoked certificates.

ids = st.frozensets(st.binary(min_size=8, max_size=8), max_size=20)


@given(st.integers(0, 2**40), st.integers(0, 2**40), ids)
def test_a_list_comes_back_as_it_was_issued(issued, due, certificate_ids):
    revoked = RevocationList(issued, due, certificate_ids)
    assert read_revocations(issue_revocations(revoked, authority=AUTHORITY_KEY), AUTHORITIES) == revoked


def test_the_longest_list_comes_back():
    revoked = RevocationList(0, 1, frozenset(n.to_bytes(8, "big") for n in range(REVOCATIONS_LIMIT_COUNT)))
    assert read_revocations(issue_revocations(revoked, authority=AUTHORITY_KEY), AUTHORITIES) == revoked
    longer = RevocationList(0, 1, revoked.certificate_ids | {b"too many"})
    with pytest.raises(WireError) as caught:
        issue_revocations(longer, authority=AUTHORITY_KEY)
    assert caught.value.reason is Reason.OUT_OF_RANGE


@given(st.integers(0, 10**6), st.integers(0, 7))
def test_a_list_with_any_bit_changed_is_refused(position, bit):
    revoked = RevocationList(NOW_UNIX_S, NOW_UNIX_S + 1, frozenset({b"stolen!!", b"another!"}))
    changed = bytearray(issue_revocations(revoked, authority=AUTHORITY_KEY))
    changed[position % len(changed)] ^= 1 << bit
    with pytest.raises(WireError):
        read_revocations(bytes(changed), AUTHORITIES)


def test_a_list_of_another_authority_is_refused():
    listed = issue_revocations(RevocationList(0, 1, frozenset()), authority=OTHER_AUTHORITY_KEY)
    with pytest.raises(WireError) as caught:
        read_revocations(listed, AUTHORITIES)
    assert caught.value.reason is Reason.UNKNOWN_KEY


@pytest.mark.parametrize(
    "fields",
    [
        {0: 1, 1: 2, 2: b"1234567"},
        {0: 1, 1: 2, 2: b"bbbbbbbbaaaaaaaa"},
        {0: 1, 1: 2, 2: b"aaaaaaaaaaaaaaaa"},
        {0: 1, 1: 2, 2: [b"aaaaaaaa"]},
        {0: 1, 2: b""},
        {0: 1, 1: 2, 2: b"", 3: 0},
    ],
    ids=repr,
)
def test_a_list_in_another_spelling_is_malformed_however_well_signed(fields):
    with pytest.raises(WireError) as caught:
        read_revocations(encoded(fields, purpose="REVOCATIONS"), AUTHORITIES)
    assert caught.value.reason is Reason.MALFORMED
