"""What one end of the air signs with and whom it believes, from the files that an operator brings.

Both ends read the same files and go by them anew when they change, so that keys, authorities and lists of revoked
certificates are replaced without a restart. Here are the rules; whoever uses them reads the files.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from roadgrip.certificates import RevocationList, certificate_in_pem, certificate_to_pem, read_revocations
from roadgrip.errors import ConfigurationError, WireError
from roadgrip.sign1 import private_key_in, public_key_in
from roadgrip.signing import Signer, Verifier, authorities_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_Read = TypeVar("_Read")
_DAY_S = 86_400.0
ENDS_SOON_S = 30 * _DAY_S
"""A unit's certificate that ends sooner is worth a warning."""


class NamedFile(NamedTuple):
    """A file that was read.

    Attributes:
        name: For messages.
        content: All of it.
    """

    name: str
    content: bytes


class TrustFiles(NamedTuple):
    """The files that trust rests on.

    Attributes:
        credentials: Each a private key and its certificate, as `credential_to_pem` writes them: one of a unit, the
            pseudonyms of a vehicle.
        authorities: Each the public key of an authority (PEM).
        revocations: The signed list of certificates that were taken back.
    """

    credentials: tuple[NamedFile, ...] = ()
    authorities: tuple[NamedFile, ...] = ()
    revocations: NamedFile | None = None


NO_FILES = TrustFiles()


@dataclass(frozen=True, slots=True)
class Trust:
    """What one end signs with and whom it believes.

    Attributes:
        signers: What it may sign with; none: it sends unsigned.
        verifier: Whom it believes; None if it trusts no authority.
        files: What all this was made from.
        older_list_ignored: Whether the file holds a list that was issued before the one in use.
    """

    signers: tuple[Signer, ...] = ()
    verifier: Verifier | None = None
    files: TrustFiles = NO_FILES
    older_list_ignored: bool = False

    @property
    def signer(self) -> Signer | None:
        """What a unit signs with."""
        return self.signers[0] if self.signers else None

    @property
    def revocations(self) -> RevocationList | None:
        """The list of revoked certificates in use."""
        return None if self.verifier is None else self.verifier.revocations


def trust_in(files: TrustFiles, *, previous: Trust | None = None) -> Trust:
    """Return the trust that files hold; the previous one itself, with all it remembers, if they have not changed.

    Args:
        files: As they are now.
        previous: What was trusted so far. Its list of revoked certificates is kept if the file holds an earlier one.

    Raises:
        ConfigurationError: A file holds something else; the message names it. The caller goes on with the previous.
    """
    if previous is not None and previous.files == files:
        return previous
    signers = tuple(_named(file, credential_in) for file in files.credentials)
    if not files.authorities:
        if files.revocations is not None:
            raise ConfigurationError(f"{files.revocations.name}: no authority is trusted that could have signed it")
        return Trust(signers, None, files)
    authorities = authorities_of([_named(file, public_key_in) for file in files.authorities])
    revocations = None
    if files.revocations is not None:
        revocations = _named(files.revocations, lambda content: read_revocations(content, authorities))
    known = None if previous is None else previous.revocations
    older = known is not None and (revocations is None or revocations.issued_unix_s < known.issued_unix_s)
    return Trust(signers, Verifier(authorities, revocations=known if older else revocations), files, older)


def trust_warnings(trust: Trust, *, now_unix_s: float, section_ids: Sequence[str] = ()) -> tuple[str, ...]:
    """Return what an operator of a unit should be told about its trust; nothing if all is well.

    Args:
        trust: In use.
        now_unix_s: Now, by a clock that can be trusted.
        section_ids: The sections that the unit serves.
    """
    told = []
    if trust.signer is not None:
        certificate = trust.signer.certificate
        name = f"certificate {certificate.certificate_id.hex()}"
        left_s = certificate.valid_until_unix_s - now_unix_s
        if not certificate.in_date(now_unix_s):
            told.append(f"{name} does not hold now: vehicles do not believe this unit")
        elif left_s < ENDS_SOON_S:
            told.append(f"{name} ends in {left_s / _DAY_S:.0f} days")
        foreign = [section_id for section_id in section_ids if not certificate.speaks_for(section_id)]
        if foreign:
            told.append(f"{name} does not permit to speak for {', '.join(foreign)}: vehicles will not believe it")
        if trust.revocations is not None and certificate.certificate_id in trust.revocations.certificate_ids:
            told.append(f"{name} was revoked: vehicles do not believe this unit")
    if trust.older_list_ignored:
        told.append("the list of revoked certificates in the file is older than the one in use, or gone; not taken")
    if trust.revocations is not None and now_unix_s > trust.revocations.due_unix_s:
        late_s = now_unix_s - trust.revocations.due_unix_s
        told.append(f"the list of revoked certificates is overdue by {late_s / _DAY_S:.1f} days; it is still used")
    return tuple(told)


def signer_for(signers: Sequence[Signer], *, passage_id: bytes, now_unix_s: float | None) -> Signer | None:
    """Return the pseudonym that a vehicle uses for one passage; another passage probably shows another one.

    The id of the passage is the dice: it is random, and all frames of a passage come out alike.

    Args:
        signers: What the vehicle has.
        passage_id: Whose messages are to be signed.
        now_unix_s: Its wall clock, or None if it has none that can be trusted.
    """
    usable = [s for s in signers if now_unix_s is None or s.certificate.in_date(now_unix_s)]
    return usable[int.from_bytes(passage_id[8:], "big") % len(usable)] if usable else None


def credential_in(pem: bytes) -> Signer:
    """Return the private key and its certificate that a PEM file holds.

    Raises:
        ConfigurationError: It does not, or they do not belong together.
    """
    certificate = certificate_in_pem(pem)
    private_key = private_key_in(pem)
    if private_key.public_key().public_bytes_raw() != certificate.public_key:
        raise ConfigurationError("the certificate is that of another key")
    return Signer(certificate, private_key)


def credential_to_pem(signer: Signer) -> bytes:
    """Return the content of the file that holds a private key and its certificate."""
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    key = signer.private_key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    return key + certificate_to_pem(signer.certificate)


def _named(file: NamedFile, read: Callable[[bytes], _Read]) -> _Read:
    try:
        return read(file.content)
    except (ConfigurationError, WireError) as error:
        raise ConfigurationError(f"{file.name}: {error}") from error
