"""An authority and those it has certified, for measurements and tests."""

from __future__ import annotations

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from roadgrip.belief import unit_claims
from roadgrip.certificates import Role, issue_certificate
from roadgrip.protocol import Kind
from roadgrip.records import MapOffer, Message
from roadgrip.signing import Claims, Signer, Verifier, authorities_of
from roadgrip.wire import kind_of

NOW_UNIX_S = 1_770_000_100
YEAR_S = 365 * 86_400
# Keys of tests; they open nothing. The first is the first test key of RFC 8032.
AUTHORITY_KEY = Ed25519PrivateKey.from_private_bytes(
    bytes.fromhex("9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60")
)
OTHER_AUTHORITY_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
UNIT_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(1, 33)))
VEHICLE_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(2, 34)))


def signer_of(
    role: Role,
    *,
    private_key: Ed25519PrivateKey | None = None,
    authority: Ed25519PrivateKey = AUTHORITY_KEY,
    section_ids: tuple[str, ...] = (),
    certificate_id: bytes | None = None,
    valid_from_unix_s: int = NOW_UNIX_S - YEAR_S,
    valid_until_unix_s: int = NOW_UNIX_S + YEAR_S,
) -> Signer:
    """Return somebody with a certificate; the tests' key of the role and a fixed id unless others are given."""
    if private_key is None:
        private_key = UNIT_KEY if role is Role.UNIT else VEHICLE_KEY
    certificate = issue_certificate(
        private_key.public_key().public_bytes_raw(),
        authority=authority,
        certificate_id=certificate_id or f"{role.value:8.8}".encode(),
        role=role,
        section_ids=section_ids,
        valid_from_unix_s=valid_from_unix_s,
        valid_until_unix_s=valid_until_unix_s,
    )
    return Signer(certificate, private_key)


UNIT = signer_of(Role.UNIT)
VEHICLE = signer_of(Role.VEHICLE)
AUTHORITIES = authorities_of([AUTHORITY_KEY.public_key()])
VERIFIER = Verifier(AUTHORITIES)


def rightful_signer_of(message: Message) -> Signer:
    """Return somebody who may say it."""
    return VEHICLE if kind_of(message) in {Kind.ARRIVAL, Kind.SUMMARY} else UNIT


def claims_for(message: Message, *, section_id: str, map_version: str = "", now_unix_s: int = NOW_UNIX_S) -> Claims:
    """Return what its rightful signer claims of a message."""
    if kind_of(message) in {Kind.ARRIVAL, Kind.SUMMARY}:
        return Claims(issued_unix_s=now_unix_s)
    if isinstance(message, MapOffer):
        section_id, map_version = message.section.section_id, message.section.version
    version = getattr(message, "map_version", map_version) or map_version
    return unit_claims(message, section_id=section_id, map_version=version, issued_unix_s=now_unix_s)
