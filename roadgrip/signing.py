"""Signed messages: COSE_Sign1 (RFC 9052) with Ed25519.

A signature covers the payload, the protected header with the key's id, and the name of the protocol and message
kind, so that a signed ARRIVAL can never pass for anything else. Who may sign what is decided by which keys a
receiver is given: a vehicle holds the keys of road side units, a unit those of the vehicles it serves. A vehicle's
key should be a pseudonym or a group's key, since its id is visible in every message it signs.

The library of the cryptography is loaded with the first key: a car without keys saves 7 MB and its start some time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cbor2

from roadgrip.cbor import TAG_SIGN1, strict_dumps, strict_loads
from roadgrip.errors import ConfigurationError, WireError
from roadgrip.reasons import Reason

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

KEY_ID_BYTES = 8
KEY_ID_LIMIT_BYTES = 32
SIGNATURE_BYTES = 64
SIGNED_MORE_BYTES = 110
"""No signature makes a message longer by more than this, whatever the length of the key's id."""
SIGN1_INITIAL_BYTE = 0xC0 | TAG_SIGN1
"""What a signed message begins with; an unsigned one begins with a map."""

_HEADER_ALGORITHM = 1
_HEADER_KEY_ID = 4
_ALGORITHM_EDDSA = -8


@dataclass(frozen=True, slots=True)
class Signer:
    """A key to sign with.

    Attributes:
        key_id: By which receivers find the public key; at most 32 bytes, usually `key_id_of` it.
        private_key: The key.
    """

    key_id: bytes
    private_key: Ed25519PrivateKey


@dataclass(frozen=True, slots=True)
class Verifier:
    """The keys that are believed.

    Attributes:
        public_keys: By key id.
        required: Whether an unsigned message is refused. A signed one must verify in any case.
    """

    public_keys: Mapping[bytes, Ed25519PublicKey]
    required: bool


def key_id_of(public_key: Ed25519PublicKey) -> bytes:
    """Return the id of a key: the first eight bytes of the SHA-256 of its 32 raw bytes."""
    return hashlib.sha256(public_key.public_bytes_raw()).digest()[:KEY_ID_BYTES]


def signer_from_pem(pem: bytes) -> Signer:
    """Return the signer of an unencrypted Ed25519 private key in PEM, under the id `key_id_of` gives it.

    Raises:
        ConfigurationError: It is no such key.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    try:
        key = load_pem_private_key(pem, password=None)
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"not an unencrypted private key in PEM: {error}") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise ConfigurationError(f"messages are signed with Ed25519, this is {type(key).__name__}")
    return Signer(key_id_of(key.public_key()), key)


def verifier_from_pems(pems: list[bytes], *, required: bool) -> Verifier:
    """Return a verifier that believes the Ed25519 public keys in PEM, each under the id `key_id_of` gives it.

    Raises:
        ConfigurationError: One is no such key, or signatures are required and there is no key.
    """
    if required and not pems:
        raise ConfigurationError("signatures are required but no public key is given")
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    keys = {}
    for pem in pems:
        try:
            key = load_pem_public_key(pem)
        except ValueError as error:
            raise ConfigurationError(f"not a public key in PEM: {error}") from error
        if not isinstance(key, Ed25519PublicKey):
            raise ConfigurationError(f"messages are signed with Ed25519, this is {type(key).__name__}")
        keys[key_id_of(key)] = key
    return Verifier(keys, required)


def signature_structure(*, protected: bytes, external_aad: bytes, payload: bytes) -> bytes:
    """Return the bytes that a COSE_Sign1 signature is made over.

    References:
        RFC 9052, section 4.4, Sig_structure.
    """
    return strict_dumps(["Signature1", protected, external_aad, payload])


def sign(payload: bytes, *, signer: Signer, external_aad: bytes) -> bytes:
    """Return the payload inside a tagged COSE_Sign1. Ed25519 is deterministic: the same in gives the same out."""
    protected = _protected_header(signer.key_id)
    signature = signer.private_key.sign(
        signature_structure(protected=protected, external_aad=external_aad, payload=payload)
    )
    return strict_dumps(cbor2.CBORTag(TAG_SIGN1, [protected, {}, payload, signature]))


def open_payload(data: bytes, *, verifier: Verifier | None, external_aad: bytes) -> bytes:
    """Return the payload of a message, signed or not.

    Args:
        data: The message.
        verifier: The keys that are believed. None: a signature is taken off without a look, for a receiver that
            has no keys and asks for none.
        external_aad: What the signature covers besides, not sent.

    Raises:
        WireError: UNSIGNED, BAD_SIGNATURE, UNKNOWN_KEY, or MALFORMED when it begins like a COSE_Sign1 but is none.
    """
    if not data or data[0] != SIGN1_INITIAL_BYTE:
        if verifier is not None and verifier.required:
            raise WireError(Reason.UNSIGNED, "this receiver asks for signed messages")
        return data
    protected, key_id, payload, signature = _parts(strict_loads(data))
    if verifier is None:
        return payload
    public_key = verifier.public_keys.get(key_id)
    if public_key is None:
        raise WireError(Reason.UNKNOWN_KEY, f"no key {key_id.hex()} here")
    from cryptography.exceptions import InvalidSignature

    try:
        public_key.verify(
            signature, signature_structure(protected=protected, external_aad=external_aad, payload=payload)
        )
    except InvalidSignature as error:
        raise WireError(Reason.BAD_SIGNATURE, f"the signature by key {key_id.hex()} does not fit") from error
    return payload


def _parts(message: object) -> tuple[bytes, bytes, bytes, bytes]:
    match message:
        case cbor2.CBORTag(
            tag=18, value=[bytes(protected), Mapping() as unprotected, bytes(payload), bytes(signature)]
        ):
            pass
        case _:
            raise WireError(Reason.MALFORMED, "not a COSE_Sign1 with embedded payload")
    if unprotected or len(signature) != SIGNATURE_BYTES:
        raise WireError(Reason.MALFORMED, "a COSE_Sign1 here has an empty unprotected header and a 64 byte signature")
    match strict_loads(protected):
        # Compared as bytes, since -8.0 equals -8 and True equals 1.
        case {4: bytes(key_id)} if 0 < len(key_id) <= KEY_ID_LIMIT_BYTES and protected == _protected_header(key_id):
            return protected, key_id, payload, signature
        case _:
            raise WireError(Reason.MALFORMED, "the protected header must be EdDSA and the id of a key")


def _protected_header(key_id: bytes) -> bytes:
    return strict_dumps({_HEADER_ALGORITHM: _ALGORITHM_EDDSA, _HEADER_KEY_ID: key_id})
