"""Signed messages: who says something, by which certificate, and until when it holds.

A signature covers the payload, the signer's claims, and the name of the protocol and message kind, so that a signed
ARRIVAL can never pass for anything else. The signer's certificate flies along: a receiver holds the public keys of the
authorities it trusts and nothing of the millions who may speak. Whether what was signed is believed now, and for this
section, is judged in `roadgrip.belief`.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from roadgrip.cbor import strict_dumps, strict_loads
from roadgrip.certificates import CERTIFICATE_ID_BYTES, Certificate, RevocationList, check_certificate, read_certificate
from roadgrip.errors import WireError
from roadgrip.reasons import Reason
from roadgrip.sign1 import SIGN1_INITIAL_BYTE, check_seal, key_id_of, sealed, sign1_in
from roadgrip.wire_fields import (
    UNIX_LIMIT_S,
    bytes_in,
    check_keys,
    checked_int,
    checked_section_id,
    digest_bytes,
    digest_in,
    int_in,
)

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

SIGNED_MORE_BYTES = 800
"""No signature makes a message longer by more than this, whatever its certificate and claims say."""
KNOWN_CERTIFICATES_LIMIT_COUNT = 4_096
"""Certificates whose signature need not be checked again; one takes about 1 kB."""

_ALGORITHM, _CERTIFICATE_ID, _CLAIMS = 1, 4, 15
_EDDSA = -8
_SUBJECT, _EXPIRY, _ISSUED, _MAP_VERSION = 2, 4, 6, -70_001
_USUAL_BYTES = 21
_USUAL_BEGINNING = b"\xa3\x01\x27\x04\x48"
_USUAL_CLAIM = b"\x0f\xa1\x06\x1a"
_HEADER_KEYS = frozenset({_ALGORITHM, _CERTIFICATE_ID})
_CLAIM_KEYS = frozenset({_SUBJECT, _EXPIRY, _ISSUED, _MAP_VERSION})


@dataclass(frozen=True, slots=True)
class Claims:
    """What a signer says of a message, besides the message, under the same signature.

    Attributes:
        issued_unix_s: When it was sent; None if the signer does not know the time.
        expires_unix_s: Until when it holds; None if that is not said.
        section_id: The section it is about, or nothing.
        map_version: The map of that section, or nothing.
    """

    issued_unix_s: int | None = None
    expires_unix_s: int | None = None
    section_id: str = ""
    map_version: str = ""


NO_CLAIMS = Claims()


@dataclass(frozen=True, slots=True)
class Signer:
    """A key to sign with, and the certificate that says whose it is.

    Attributes:
        certificate: Sent along with every message.
        private_key: The key that it certifies.
    """

    certificate: Certificate
    private_key: Ed25519PrivateKey


class Signed(NamedTuple):
    """Who has signed a message, and what was claimed; the signatures of both fit.

    Attributes:
        certificate: By an authority that is trusted, and not taken back. Its dates and scope are not judged.
        claims: Not judged.
    """

    certificate: Certificate
    claims: Claims


class Verifier:
    """The authorities that are believed, and what they have taken back.

    Immutable but for its memory of certificates that were checked already: a vehicle that sends twice costs one
    more signature only once.
    """

    def __init__(
        self,
        authorities: Mapping[bytes, Ed25519PublicKey],
        *,
        revocations: RevocationList | None = None,
        known_limit_count: int = KNOWN_CERTIFICATES_LIMIT_COUNT,
    ) -> None:
        """Start without a memory.

        Args:
            authorities: Their public keys, by `roadgrip.sign1.key_id_of` them.
            revocations: The certificates they have taken back.
            known_limit_count: Certificates that are remembered; the one used longest ago makes room.
        """
        self.authorities = authorities
        self.revocations = revocations
        self._revoked_ids = frozenset() if revocations is None else revocations.certificate_ids
        self._known_limit_count = known_limit_count
        self._known: OrderedDict[bytes, tuple[Certificate, Ed25519PublicKey]] = OrderedDict()

    @property
    def known_count(self) -> int:
        """Certificates that are remembered."""
        return len(self._known)

    def unsealed(self, data: bytes, *, external_aad: bytes) -> tuple[bytes, Signed]:
        """Return the payload of a signed message and who has signed it.

        Raises:
            WireError: MALFORMED, UNKNOWN_KEY, BAD_SIGNATURE or CERTIFICATE_REVOKED.
        """
        signed = sign1_in(data)
        if not signed.certificate:
            raise WireError(Reason.MALFORMED, "a signed message carries the certificate of its signer")
        certificate, public_key = self._certified(signed.certificate)
        certificate_id, claims = _header_in(signed.protected)
        if certificate_id != certificate.certificate_id:
            raise WireError(Reason.MALFORMED, "the message is signed under another certificate than it carries")
        if certificate_id in self._revoked_ids:
            raise WireError(Reason.CERTIFICATE_REVOKED, f"certificate {certificate_id.hex()} was taken back")
        check_seal(signed, public_key=public_key, external_aad=external_aad)
        return signed.payload, Signed(certificate, claims)

    def _certified(self, encoded: bytes) -> tuple[Certificate, Ed25519PublicKey]:
        known = self._known.get(encoded)
        if known is not None:
            self._known.move_to_end(encoded)
            return known
        certificate = read_certificate(encoded)
        check_certificate(certificate, self.authorities)
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        known = self._known[encoded] = certificate, Ed25519PublicKey.from_public_bytes(certificate.public_key)
        if len(self._known) > self._known_limit_count:
            self._known.popitem(last=False)
        return known


def sign(payload: bytes, *, signer: Signer, external_aad: bytes, claims: Claims = NO_CLAIMS) -> bytes:
    """Return the payload inside a COSE_Sign1 with the signer's certificate.

    Raises:
        WireError: A claim has no spelling.
    """
    return sealed(
        payload,
        private_key=signer.private_key,
        protected=_header_of(signer.certificate.certificate_id, claims),
        external_aad=external_aad,
        certificate=signer.certificate.encoded,
    )


def is_signed(data: bytes) -> bool:
    """Return whether a message begins like a signed one."""
    return bool(data) and data[0] == SIGN1_INITIAL_BYTE


def open_payload(
    data: bytes, *, verifier: Verifier | None, required: bool, external_aad: bytes
) -> tuple[bytes, Signed | None]:
    """Return the payload of a message, and who has signed it if anybody has.

    Args:
        data: The message.
        verifier: Who is believed. None: a signature is taken off without a look, for a receiver that asks for none.
        required: Whether an unsigned message is refused. A signed one must verify in any case.
        external_aad: What the signature covers besides, not sent.

    Raises:
        WireError: UNSIGNED, UNKNOWN_KEY, or as `Verifier.unsealed`.
    """
    if not is_signed(data):
        if required:
            raise WireError(Reason.UNSIGNED, "this receiver asks for signed messages")
        return data, None
    if verifier is None:
        if required:
            raise WireError(Reason.UNKNOWN_KEY, "no authority is trusted here")
        return sign1_in(data).payload, None
    return verifier.unsealed(data, external_aad=external_aad)


def authorities_of(public_keys: list[Ed25519PublicKey]) -> dict[bytes, Ed25519PublicKey]:
    """Return the keys of authorities by their ids."""
    return {key_id_of(key): key for key in public_keys}


@lru_cache(maxsize=256)
def _header_of(certificate_id: bytes, claims: Claims) -> bytes:
    # What a unit claims is the same for all receipts of a second about one section.
    header: dict[int, Any] = {_ALGORITHM: _EDDSA, _CERTIFICATE_ID: certificate_id}
    said: dict[int, Any] = {}
    if claims.section_id:
        said[_SUBJECT] = checked_section_id(claims.section_id)
    for key, moment_unix_s in ((_EXPIRY, claims.expires_unix_s), (_ISSUED, claims.issued_unix_s)):
        if moment_unix_s is not None:
            said[key] = checked_int(moment_unix_s, name="a moment", low=0, high=UNIX_LIMIT_S)
    if claims.map_version:
        said[_MAP_VERSION] = digest_bytes(claims.map_version, name="the map version")
    if said:
        header[_CLAIMS] = said
    return strict_dumps(header)


def _header_in(protected: bytes) -> tuple[bytes, Claims]:
    # What nearly every vehicle sends has one spelling and a fixed length; this reads it ten times as fast.
    if (
        len(protected) == _USUAL_BYTES
        and protected[:5] == _USUAL_BEGINNING
        and protected[13:17] == _USUAL_CLAIM
        and protected[17:19] != b"\0\0"
    ):
        return protected[5:13], Claims(issued_unix_s=int.from_bytes(protected[17:], "big"))
    header = check_keys(strict_loads(protected), required=_HEADER_KEYS, optional=frozenset({_CLAIMS}))
    checked_int(header[_ALGORITHM], name="the algorithm", low=_EDDSA, high=_EDDSA, reason=Reason.MALFORMED)
    certificate_id = bytes_in(header, _CERTIFICATE_ID, size=CERTIFICATE_ID_BYTES, name="the id of a certificate")
    if _CLAIMS not in header:
        return certificate_id, NO_CLAIMS
    said = check_keys(header[_CLAIMS], required=frozenset(), optional=_CLAIM_KEYS)
    if not said:
        raise WireError(Reason.MALFORMED, "claims that claim nothing")
    return certificate_id, Claims(
        issued_unix_s=int_in(said, _ISSUED, name="a moment", high=UNIX_LIMIT_S) if _ISSUED in said else None,
        expires_unix_s=int_in(said, _EXPIRY, name="a moment", high=UNIX_LIMIT_S) if _EXPIRY in said else None,
        section_id=checked_section_id(said[_SUBJECT]) if _SUBJECT in said else "",
        map_version=digest_in(said, _MAP_VERSION, name="the map version") if _MAP_VERSION in said else "",
    )
