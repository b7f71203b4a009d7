"""COSE_Sign1 (RFC 9052) with Ed25519: the envelope of everything that is signed, and the keys in PEM.

Messages, certificates and lists of revoked certificates are signed alike: a protected header that names the key, a
payload, and external data that is covered without being sent, so that a signature for one purpose never holds for
another. A message carries the certificate of its signer in the unprotected header (kcwt of RFC 9528).

The envelope is read by hand, since all of it has one spelling and its parts are byte strings: a unit that checks
thousands of messages in a second looks certificates up by their very bytes.

The library of the cryptography is loaded with the first key: a car without keys saves 7 MB and its start some time.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, NamedTuple

from roadgrip.errors import ConfigurationError, WireError
from roadgrip.protocol import PROTOCOL_NAME, PROTOCOL_VERSION
from roadgrip.reasons import Reason

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

KEY_ID_BYTES = 8
PUBLIC_KEY_BYTES = 32
SIGNATURE_BYTES = 64
SIGN1_INITIAL_BYTE = 0xD2
"""What a signed message begins with, the tag of COSE_Sign1; an unsigned one begins with a map."""

_BEGINNING = b"\xd2\x84"
_NO_HEADER = b"\xa0"
_CERTIFICATE_HEADER = b"\xa1\x0d"
_CONTEXT = b"\x84\x6aSignature1"


class Sign1(NamedTuple):
    """A signed thing, taken apart; nothing in it is believed yet.

    Attributes:
        protected: The encoded protected header.
        certificate: The encoded certificate in the unprotected header, or nothing.
        payload: What is signed.
        signature: 64 bytes.
    """

    protected: bytes
    certificate: bytes
    payload: bytes
    signature: bytes


def sign1_in(data: bytes) -> Sign1:
    """Return the parts of an encoded COSE_Sign1.

    Raises:
        WireError: MALFORMED; it is none, or not in its only spelling.
    """
    try:
        signed, end = _sign1_at(data, 0, may_certify=True)
    except IndexError:
        raise WireError(Reason.MALFORMED, "a COSE_Sign1 that ends early") from None
    if end != len(data):
        raise WireError(Reason.MALFORMED, "bytes behind a COSE_Sign1")
    return signed


def sealed(
    payload: bytes, *, private_key: Ed25519PrivateKey, protected: bytes, external_aad: bytes, certificate: bytes = b""
) -> bytes:
    """Return a payload inside a tagged COSE_Sign1. Ed25519 is deterministic: the same in gives the same out.

    Args:
        payload: What is signed.
        private_key: Signs.
        protected: The encoded protected header.
        external_aad: What the signature covers besides, not sent.
        certificate: The encoded certificate of the key, if it is sent along.
    """
    signature = private_key.sign(signature_structure(protected=protected, external_aad=external_aad, payload=payload))
    unprotected = _CERTIFICATE_HEADER + certificate if certificate else _NO_HEADER
    return b"".join((_BEGINNING, _string(protected), unprotected, _string(payload), _string(signature)))


def check_seal(signed: Sign1, *, public_key: Ed25519PublicKey, external_aad: bytes) -> None:
    """Do nothing if the signature fits.

    Raises:
        WireError: BAD_SIGNATURE.
    """
    try:
        public_key.verify(
            signed.signature,
            signature_structure(protected=signed.protected, external_aad=external_aad, payload=signed.payload),
        )
    except Exception as error:
        # Imported here: a unit that checks a thousand good signatures need not ask for it a thousand times.
        from cryptography.exceptions import InvalidSignature

        if not isinstance(error, InvalidSignature):
            raise
        raise WireError(Reason.BAD_SIGNATURE, "the signature does not fit") from None


def signature_structure(*, protected: bytes, external_aad: bytes, payload: bytes) -> bytes:
    """Return the bytes that a COSE_Sign1 signature is made over.

    References:
        RFC 9052, section 4.4, Sig_structure.
    """
    return b"".join((_CONTEXT, _string(protected), _string(external_aad), _string(payload)))


def external_aad_for(purpose: str) -> bytes:
    """Return what a signature covers besides the payload, without being sent: protocol, version and purpose."""
    return f"{PROTOCOL_NAME}/{PROTOCOL_VERSION}/{purpose}".encode()


# Keys


def key_id_of(public_key: Ed25519PublicKey) -> bytes:
    """Return the id of an authority's key: the first eight bytes of the SHA-256 of its 32 raw bytes."""
    return hashlib.sha256(public_key.public_bytes_raw()).digest()[:KEY_ID_BYTES]


def private_key_in(pem: bytes, *, password: bytes | None = None) -> Ed25519PrivateKey:
    """Return the Ed25519 private key that a PEM text holds.

    Args:
        pem: The text.
        password: Opens it, if it is encrypted.

    Raises:
        ConfigurationError: It holds no such key, or is encrypted otherwise.
    """
    from cryptography.exceptions import InternalError, UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(pem, password=password)
    except InternalError as error:
        # What the library makes of a key with a byte too many or too few. Its words are about the library.
        raise ConfigurationError("not a private key in PEM that can be opened: its bytes are no key") from error
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise ConfigurationError(f"not a private key in PEM that can be opened: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise ConfigurationError(f"signatures are made with Ed25519, this is {type(key).__name__}")
    return key


def public_key_in(pem: bytes) -> Ed25519PublicKey:
    """Return the Ed25519 public key that a PEM text holds.

    Raises:
        ConfigurationError: It holds no such key.
    """
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    try:
        key = load_pem_public_key(pem)
    except (ValueError, UnsupportedAlgorithm) as error:
        raise ConfigurationError(f"not a public key in PEM: {error}") from error
    if not isinstance(key, Ed25519PublicKey):
        raise ConfigurationError(f"signatures are made with Ed25519, this is {type(key).__name__}")
    return key


# Byte strings in their only spelling


def _sign1_at(data: bytes, start: int, *, may_certify: bool) -> tuple[Sign1, int]:
    """Return what begins at a byte, and the first byte behind it; IndexError where the data end early."""
    if data[start : start + 2] != _BEGINNING:
        raise WireError(Reason.MALFORMED, "not a COSE_Sign1 with embedded payload")
    protected, at = _string_at(data, start + 2)
    certificate = b""
    if data[at] == _NO_HEADER[0]:
        at += 1
    elif may_certify and data[at : at + 2] == _CERTIFICATE_HEADER:
        _, end = _sign1_at(data, at + 2, may_certify=False)
        certificate = data[at + 2 : end]
        at = end
    else:
        raise WireError(Reason.MALFORMED, "an unprotected header holds the signer's certificate and nothing else")
    payload, at = _string_at(data, at)
    signature, at = _string_at(data, at)
    if len(signature) != SIGNATURE_BYTES:
        raise WireError(Reason.MALFORMED, f"a signature of {len(signature)} bytes")
    return Sign1(protected, certificate, payload, signature), at


def _string_at(data: bytes, start: int) -> tuple[bytes, int]:
    head = data[start]
    if head == 0x58:
        size, begin, least = data[start + 1], start + 2, 24
    elif 0x40 <= head < 0x58:
        size, begin, least = head - 0x40, start + 1, 0
    elif head == 0x59:
        size, begin, least = data[start + 1] << 8 | data[start + 2], start + 3, 256
    else:
        raise WireError(Reason.MALFORMED, "a COSE_Sign1 is made of byte strings")
    end = begin + size
    if size < least or end > len(data):
        raise WireError(Reason.MALFORMED, "a byte string that ends early or has another spelling")
    return data[begin:end], end


def _string(content: bytes) -> bytes:
    size = len(content)
    if size < 24:
        return bytes((0x40 + size,)) + content
    if size < 256:
        return bytes((0x58, size)) + content
    if size < 65_536:
        return b"\x59" + size.to_bytes(2, "big") + content
    raise WireError(Reason.OVERSIZED, f"{size} bytes cannot be signed")
