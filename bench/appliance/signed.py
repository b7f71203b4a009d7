"""Vehicles with certificates, and the unit that asks for them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from bench.appliance.passages import Batch, frame_of
from bench.certified import AUTHORITY_KEY, YEAR_S, signer_of
from roadgrip.certificates import CERTIFICATE_ID_BYTES, Role
from roadgrip.protocol import Kind, external_aad_of
from roadgrip.signing import Claims, Signer, sign
from roadgrip.trust import credential_to_pem

CERTIFICATES_COUNT = 4_000
"""As many as a unit remembers, see `roadgrip.signing.KNOWN_CERTIFICATES_LIMIT_COUNT`."""


@dataclass(frozen=True)
class Vehicles:
    """Who signs passages, one after the other.

    Attributes:
        signers: Each with a key and a certificate of its own.
        unit: The credential of the unit.
    """

    signers: Sequence[Signer]
    unit: Signer

    @classmethod
    def issued(cls, *, rng: np.random.Generator, count: int = CERTIFICATES_COUNT) -> Vehicles:
        """Return vehicles with certificates that hold for a year.

        Args:
            rng: Draws keys and ids, which open nothing.
            count: How many vehicles.
        """
        now_unix_s = int(time.time())
        from_s, until_s = now_unix_s - YEAR_S // 2, now_unix_s + YEAR_S // 2
        signers = [
            signer_of(
                Role.VEHICLE,
                private_key=Ed25519PrivateKey.from_private_bytes(rng.bytes(32)),
                certificate_id=rng.bytes(CERTIFICATE_ID_BYTES),
                valid_from_unix_s=from_s,
                valid_until_unix_s=until_s,
            )
            for _ in range(count)
        ]
        return cls(signers, signer_of(Role.UNIT, valid_from_unix_s=from_s, valid_until_unix_s=until_s))

    def frames_of(self, batch: Batch) -> list[bytes]:
        """Return each passage as the one frame that it takes, signed by the next vehicle."""
        claims, external_aad = Claims(issued_unix_s=int(time.time())), external_aad_of(Kind.SUMMARY, exchange_id=b"")
        frames = []
        for number, (drive, passage_id, message) in enumerate(batch.messages()):
            signer = self.signers[number % len(self.signers)]
            signed = sign(message, signer=signer, external_aad=external_aad, claims=claims)
            frames.append(frame_of(drive, passage_id, signed))
        return frames


def signed_settings(folder: Path, vehicles: Vehicles) -> str:
    """Return the settings of a unit that requires signatures over UDP, and write the files they name.

    Args:
        folder: Holds the unit's configuration.
        vehicles: Whom it shall believe.
    """
    (folder / "unit.pem").write_bytes(credential_to_pem(vehicles.unit))
    authorities = folder / "authorities"
    authorities.mkdir(exist_ok=True)
    public = AUTHORITY_KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    (authorities / "authority.pem").write_bytes(public)
    keys = '[signing]\ncredential_file = "unit.pem"\nauthorities_folder = "authorities"\n'
    # Few vehicles stand for many here; each would soon have sent what it may in an hour.
    quota = "[ingest]\npassages_per_certificate_count = 10000\n"
    return f'signatures = "required"\n{keys}{quota}'
