"""What one end goes by: files that belong together, and what its operator is warned of."""

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from bench.certified import (
    AUTHORITY_KEY,
    NOW_UNIX_S,
    OTHER_AUTHORITY_KEY,
    UNIT,
    VEHICLE,
    YEAR_S,
    signer_of,
)
from roadgrip.certificates import RevocationList, Role, certificate_to_pem, issue_revocations
from roadgrip.errors import ConfigurationError
from roadgrip.sign1 import private_key_in, public_key_in
from roadgrip.trust import (
    NamedFile,
    Trust,
    TrustFiles,
    credential_in,
    credential_to_pem,
    signer_for,
    trust_in,
    trust_warnings,
)


def public_pem_of(key) -> bytes:
    pem: bytes = key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    return pem


def files(*, signer=UNIT, issued_unix_s: int = NOW_UNIX_S, due_unix_s: int = NOW_UNIX_S + 1, ids=frozenset()):
    listed = issue_revocations(RevocationList(issued_unix_s, due_unix_s, ids), authority=AUTHORITY_KEY)
    return TrustFiles(
        (NamedFile("unit.pem", credential_to_pem(signer)),),
        (NamedFile("road.pem", public_pem_of(AUTHORITY_KEY)),),
        NamedFile("revoked.cose", listed),
    )


def test_a_credential_comes_back():
    assert credential_in(credential_to_pem(UNIT)).certificate == UNIT.certificate


def test_a_certificate_that_is_put_behind_its_key_makes_a_credential():
    key = UNIT.private_key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    assert credential_in(key + b"\n" + certificate_to_pem(UNIT.certificate)).certificate == UNIT.certificate
    assert credential_in(certificate_to_pem(UNIT.certificate) + key).certificate == UNIT.certificate


def test_key_and_certificate_must_belong_together():
    mixed = credential_to_pem(VEHICLE).partition(b"-----BEGIN ROAD")[0] + certificate_to_pem(UNIT.certificate)
    with pytest.raises(ConfigurationError, match="another key"):
        credential_in(mixed)


# An Ed25519 private key of 33 bytes instead of 32.
OVERLONG_KEY = b"""-----BEGIN PRIVATE KEY-----
MC8CAQAwBQYDK2VwBCMEIQABAgMEBQYHCAkKCwwNDg8QERITFBUWFxgZGhscHR4fIA==
-----END PRIVATE KEY-----
"""


@pytest.mark.parametrize("pem", [b"", b"not a key", public_pem_of(AUTHORITY_KEY), OVERLONG_KEY])
def test_what_is_no_private_key_is_a_configuration_error(pem):
    with pytest.raises(ConfigurationError):
        private_key_in(pem)


@pytest.mark.parametrize("pem", [b"", b"not a key", credential_to_pem(UNIT)])
def test_what_is_no_public_key_is_a_configuration_error(pem):
    with pytest.raises(ConfigurationError):
        public_key_in(pem)


def test_a_key_of_another_algorithm_is_a_configuration_error():
    key = generate_private_key(SECP256R1())
    with pytest.raises(ConfigurationError, match="Ed25519"):
        private_key_in(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    with pytest.raises(ConfigurationError, match="Ed25519"):
        public_key_in(public_pem_of(key))


def test_no_files_are_no_trust():
    trust = trust_in(TrustFiles())
    assert (trust.signer, trust.verifier, trust.revocations) == (None, None, None)


def test_a_list_that_no_trusted_authority_could_have_signed_is_a_configuration_error():
    with pytest.raises(ConfigurationError, match=r"revoked\.cose"):
        trust_in(TrustFiles(revocations=files().revocations))
    foreign = issue_revocations(RevocationList(0, 1, frozenset()), authority=OTHER_AUTHORITY_KEY)
    with pytest.raises(ConfigurationError, match=r"revoked\.cose: unknown_key"):
        trust_in(files()._replace(revocations=NamedFile("revoked.cose", foreign)))


def test_a_list_that_is_gone_stays_in_use():
    before = trust_in(files(ids=frozenset({b"stolen!!"})))
    after = trust_in(files()._replace(revocations=None), previous=before)
    assert after.revocations == before.revocations
    assert any("older than the one in use" in told for told in trust_warnings(after, now_unix_s=NOW_UNIX_S))


# What an operator is told.


def warnings_of(signer=UNIT, *, now_unix_s: float = NOW_UNIX_S, section_ids=("bend",), **more) -> str:
    return "; ".join(
        trust_warnings(trust_in(files(signer=signer, **more)), now_unix_s=now_unix_s, section_ids=section_ids)
    )


def test_all_is_well():
    assert warnings_of() == ""
    assert trust_warnings(Trust(), now_unix_s=NOW_UNIX_S) == ()


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        (warnings_of(signer_of(Role.UNIT, valid_until_unix_s=NOW_UNIX_S - 1)), "does not hold now"),
        (warnings_of(signer_of(Role.UNIT, valid_until_unix_s=NOW_UNIX_S + 86_400 * 3)), "ends in 3 days"),
        (warnings_of(signer_of(Role.UNIT, section_ids=("other",))), "does not permit to speak for bend"),
        (warnings_of(VEHICLE), "does not permit"),
        (warnings_of(ids=frozenset({UNIT.certificate.certificate_id})), "was revoked"),
        (warnings_of(now_unix_s=NOW_UNIX_S + 86_401), "overdue by 1.0 days; it is still used"),
    ],
)
def test_an_operator_is_told(told, expected):
    assert expected in told


# Which pseudonym.


def test_a_pseudonym_in_date_is_chosen_by_the_passage():
    ended = signer_of(Role.VEHICLE, valid_until_unix_s=NOW_UNIX_S - YEAR_S // 2, valid_from_unix_s=0)
    assert signer_for([ended, VEHICLE], passage_id=bytes(16), now_unix_s=NOW_UNIX_S) is VEHICLE
    assert signer_for([ended], passage_id=bytes(16), now_unix_s=NOW_UNIX_S) is None
    assert signer_for([ended], passage_id=bytes(16), now_unix_s=None) is ended
    assert signer_for([], passage_id=bytes(16), now_unix_s=None) is None
