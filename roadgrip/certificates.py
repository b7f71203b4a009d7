"""Certificates: an authority's word on who may say what on the air, and the list of those it has taken back.

A certificate is a CWT (RFC 8392) in a COSE_Sign1: a key (cnf, RFC 8747), from when until when, a random id, and a
scope, which is what its holder is. A road side unit's names the sections it may speak for; a vehicle's is a pseudonym
that names nobody. An authority's certificates are believed by whoever holds its public key.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from roadgrip.cbor import strict_dumps, strict_loads
from roadgrip.errors import ConfigurationError, WireError
from roadgrip.reasons import Reason
from roadgrip.sign1 import (
    KEY_ID_BYTES,
    PUBLIC_KEY_BYTES,
    Sign1,
    check_seal,
    external_aad_for,
    key_id_of,
    sealed,
    sign1_in,
)
from roadgrip.wire_fields import (
    UNIX_LIMIT_S,
    bytes_in,
    check_keys,
    checked_int,
    checked_section_id,
    int_in,
    text_in,
)

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

CERTIFICATE_ID_BYTES = 8
SCOPE_LIMIT_CHARS = 400
"""Room for eight of the longest section ids, or some twenty usual ones."""
REVOCATIONS_LIMIT_COUNT = 8_000
"""Fits one byte string. What has run out by itself leaves the list."""
CERTIFICATE_LABEL = "ROADGRIP CERTIFICATE"
"""Of the block in a PEM file, beside that of the private key."""

_CERTIFICATE_AAD = external_aad_for("CERTIFICATE")
_REVOCATIONS_AAD = external_aad_for("REVOCATIONS")
_ALGORITHM, _KEY_ID = 1, 4
_EDDSA = -8
_EXPIRY, _NOT_BEFORE, _ID, _CONFIRMATION, _SCOPE = 4, 5, 7, 8, 9
_COSE_KEY = 1
_KEY_TYPE, _CURVE, _X = 1, -1, -2
_OCTET_KEY_PAIR, _ED25519 = 1, 6
_ISSUED, _DUE, _IDS = 0, 1, 2


class Role(StrEnum):
    """What the holder of a certificate is."""

    VEHICLE = "vehicle"
    UNIT = "unit"


@dataclass(frozen=True, slots=True)
class Certificate:
    """What an authority says of a key.

    Attributes:
        certificate_id: 8 random bytes, by which it is named and taken back.
        authority_id: `roadgrip.sign1.key_id_of` the authority's key.
        role: What the holder is.
        section_ids: The sections a unit may speak for; empty: all.
        valid_from_unix_s: When it begins.
        valid_until_unix_s: When it ends.
        public_key: The holder's, 32 raw bytes.
        encoded: The certificate as it is sent.
    """

    certificate_id: bytes
    authority_id: bytes
    role: Role
    section_ids: tuple[str, ...]
    valid_from_unix_s: int
    valid_until_unix_s: int
    public_key: bytes
    encoded: bytes = field(repr=False)

    def in_date(self, unix_s: float) -> bool:
        """Return whether it holds at a moment."""
        return self.valid_from_unix_s <= unix_s <= self.valid_until_unix_s

    def speaks_for(self, section_id: str) -> bool:
        """Return whether its holder is a unit that may speak for a section."""
        return self.role is Role.UNIT and (not self.section_ids or section_id in self.section_ids)


@dataclass(frozen=True, slots=True)
class RevocationList:
    """The certificates that are taken back before they end.

    Attributes:
        issued_unix_s: When it was made; an earlier one never replaces a later one.
        due_unix_s: By when the next is due. After that it is still used, and the operator told.
        certificate_ids: Which.
    """

    issued_unix_s: int
    due_unix_s: int
    certificate_ids: frozenset[bytes]


def issue_certificate(
    public_key: bytes,
    *,
    authority: Ed25519PrivateKey,
    certificate_id: bytes,
    role: Role,
    section_ids: tuple[str, ...] = (),
    valid_from_unix_s: int,
    valid_until_unix_s: int,
) -> Certificate:
    """Return a new certificate.

    Args:
        public_key: The holder's, 32 raw bytes.
        authority: Signs it.
        certificate_id: 8 random bytes.
        role: What the holder is.
        section_ids: The sections a unit may speak for; empty: all.
        valid_from_unix_s: When it begins.
        valid_until_unix_s: When it ends.

    Raises:
        WireError: Something of it has no spelling.
    """
    if section_ids and role is not Role.UNIT:
        raise WireError(Reason.MALFORMED, "only units speak for sections")
    scope = role.value if not section_ids else f"{role.value}:{' '.join(sorted(set(section_ids)))}"
    claims = {
        _EXPIRY: valid_until_unix_s,
        _NOT_BEFORE: valid_from_unix_s,
        _ID: certificate_id,
        _CONFIRMATION: {_COSE_KEY: {_KEY_TYPE: _OCTET_KEY_PAIR, _CURVE: _ED25519, _X: public_key}},
        _SCOPE: scope,
    }
    encoded = sealed(
        strict_dumps(claims),
        private_key=authority,
        protected=strict_dumps({_ALGORITHM: _EDDSA, _KEY_ID: key_id_of(authority.public_key())}),
        external_aad=_CERTIFICATE_AAD,
    )
    return read_certificate(encoded)


def read_certificate(encoded: bytes) -> Certificate:
    """Return what a certificate says; whether it is believed is another question, see `check_certificate`.

    Raises:
        WireError: MALFORMED or OUT_OF_RANGE; it is none.
    """
    signed = sign1_in(encoded)
    claims = check_keys(
        strict_loads(signed.payload), required=frozenset({_EXPIRY, _NOT_BEFORE, _ID, _CONFIRMATION, _SCOPE})
    )
    valid_from = int_in(claims, _NOT_BEFORE, name="the begin", high=UNIX_LIMIT_S)
    valid_until = int_in(claims, _EXPIRY, name="the end", high=UNIX_LIMIT_S)
    if valid_until < valid_from:
        raise WireError(Reason.OUT_OF_RANGE, "a certificate that ends before it begins")
    confirmation = check_keys(claims[_CONFIRMATION], required=frozenset({_COSE_KEY}))
    key = check_keys(confirmation[_COSE_KEY], required=frozenset({_KEY_TYPE, _CURVE, _X}))
    checked_int(
        key[_KEY_TYPE], name="the type of the key", low=_OCTET_KEY_PAIR, high=_OCTET_KEY_PAIR, reason=Reason.MALFORMED
    )
    checked_int(key[_CURVE], name="the curve", low=_ED25519, high=_ED25519, reason=Reason.MALFORMED)
    role, section_ids = _scope_in(text_in(claims, _SCOPE, limit_chars=SCOPE_LIMIT_CHARS, name="the scope"))
    return Certificate(
        certificate_id=bytes_in(claims, _ID, size=CERTIFICATE_ID_BYTES, name="the id of a certificate"),
        authority_id=_authority_id_in(signed),
        role=role,
        section_ids=section_ids,
        valid_from_unix_s=valid_from,
        valid_until_unix_s=valid_until,
        public_key=bytes_in(key, _X, size=PUBLIC_KEY_BYTES, name="a key"),
        encoded=encoded,
    )


def check_certificate(certificate: Certificate, authorities: Mapping[bytes, Ed25519PublicKey]) -> None:
    """Do nothing if one of the authorities has issued a certificate.

    Args:
        certificate: As `read_certificate` gave it.
        authorities: Their public keys by id.

    Raises:
        WireError: UNKNOWN_KEY, or BAD_SIGNATURE.
    """
    authority = authorities.get(certificate.authority_id)
    if authority is None:
        raise WireError(Reason.UNKNOWN_KEY, f"authority {certificate.authority_id.hex()} is not trusted here")
    check_seal(sign1_in(certificate.encoded), public_key=authority, external_aad=_CERTIFICATE_AAD)


def issue_revocations(revocations: RevocationList, *, authority: Ed25519PrivateKey) -> bytes:
    """Return the signed list of certificates that are taken back.

    Raises:
        WireError: There are too many, or one has no spelling.
    """
    payload = strict_dumps(
        {
            _ISSUED: revocations.issued_unix_s,
            _DUE: revocations.due_unix_s,
            _IDS: b"".join(sorted(revocations.certificate_ids)),
        }
    )
    encoded = sealed(
        payload,
        private_key=authority,
        protected=strict_dumps({_ALGORITHM: _EDDSA, _KEY_ID: key_id_of(authority.public_key())}),
        external_aad=_REVOCATIONS_AAD,
    )
    read_revocations(encoded, {key_id_of(authority.public_key()): authority.public_key()})
    return encoded


def read_revocations(encoded: bytes, authorities: Mapping[bytes, Ed25519PublicKey]) -> RevocationList:
    """Return the list of certificates that are taken back, if one of the authorities has signed it.

    Raises:
        WireError: MALFORMED, OUT_OF_RANGE, UNKNOWN_KEY or BAD_SIGNATURE.
    """
    signed = sign1_in(encoded)
    authority_id = _authority_id_in(signed)
    authority = authorities.get(authority_id)
    if authority is None:
        raise WireError(Reason.UNKNOWN_KEY, f"authority {authority_id.hex()} is not trusted here")
    check_seal(signed, public_key=authority, external_aad=_REVOCATIONS_AAD)
    fields = check_keys(strict_loads(signed.payload), required=frozenset({_ISSUED, _DUE, _IDS}))
    raw = fields[_IDS]
    if type(raw) is not bytes or len(raw) % CERTIFICATE_ID_BYTES:
        raise WireError(Reason.MALFORMED, "the list is not made of ids of certificates")
    if len(raw) > REVOCATIONS_LIMIT_COUNT * CERTIFICATE_ID_BYTES:
        raise WireError(Reason.OUT_OF_RANGE, f"more than {REVOCATIONS_LIMIT_COUNT} certificates are taken back")
    ids = [raw[start : start + CERTIFICATE_ID_BYTES] for start in range(0, len(raw), CERTIFICATE_ID_BYTES)]
    if ids != sorted(set(ids)):
        raise WireError(Reason.MALFORMED, "the list is not in order, or names one twice")
    return RevocationList(
        issued_unix_s=int_in(fields, _ISSUED, name="the time of issue", high=UNIX_LIMIT_S),
        due_unix_s=int_in(fields, _DUE, name="when the next is due", high=UNIX_LIMIT_S),
        certificate_ids=frozenset(ids),
    )


def certificate_to_pem(certificate: Certificate) -> bytes:
    """Return the block of a PEM file that holds a certificate."""
    text = base64.encodebytes(certificate.encoded).decode().replace("\n", "")
    lines = [text[start : start + 64] for start in range(0, len(text), 64)]
    return "\n".join(
        (f"-----BEGIN {CERTIFICATE_LABEL}-----", *lines, f"-----END {CERTIFICATE_LABEL}-----", "")
    ).encode()


def certificate_in_pem(pem: bytes) -> Certificate:
    """Return the only certificate in a PEM file, whatever else there is.

    Raises:
        ConfigurationError: It holds none, or several, or a damaged one.
    """
    blocks = re.findall(
        rb"-----BEGIN "
        + CERTIFICATE_LABEL.encode()
        + rb"-----\s([^-]*)-----END "
        + CERTIFICATE_LABEL.encode()
        + b"-----",
        pem,
    )
    if len(blocks) != 1:
        raise ConfigurationError(f"{len(blocks)} blocks {CERTIFICATE_LABEL!r} where one belongs")
    try:
        return read_certificate(base64.b64decode(b"".join(blocks[0].split()), validate=True))
    except (binascii.Error, WireError) as error:
        raise ConfigurationError(f"the certificate is damaged: {error}") from error


def _authority_id_in(signed: Sign1) -> bytes:
    header = check_keys(strict_loads(signed.protected), required=frozenset({_ALGORITHM, _KEY_ID}))
    checked_int(header[_ALGORITHM], name="the algorithm", low=_EDDSA, high=_EDDSA, reason=Reason.MALFORMED)
    if signed.certificate:
        raise WireError(Reason.MALFORMED, "what an authority signs carries no certificate")
    return bytes_in(header, _KEY_ID, size=KEY_ID_BYTES, name="the id of an authority")


def _scope_in(scope: str) -> tuple[Role, tuple[str, ...]]:
    word, colon, names = scope.partition(":")
    if word == Role.VEHICLE and not colon:
        return Role.VEHICLE, ()
    if word != Role.UNIT:
        raise WireError(Reason.MALFORMED, "a scope is that of a vehicle or a unit")
    if not colon:
        return Role.UNIT, ()
    section_ids = tuple(checked_section_id(name) for name in names.split(" "))
    if section_ids != tuple(sorted(set(section_ids))):
        raise WireError(Reason.MALFORMED, "the sections of a scope are not in order, or one stands there twice")
    return Role.UNIT, section_ids
