"""What a vehicle signs with and whom it believes, and the codecs that go by it."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from roadgrip.certificates import Role
from roadgrip.errors import ConfigurationError
from roadgrip.trust import NamedFile, Trust, TrustFiles, signer_for, trust_in
from vehicle_client.shell.codec import WireCodec

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from roadgrip.signing import Verifier

INCOMPLETE_WALL_S = 5.0
"""How long the pieces of a map may take to come together, on the wall."""
CLOCK_SET_UNIX_S = 1_700_000_000.0
"""A wall clock that shows less was never set, and judges nothing."""


def wall_clock_unix_s() -> float | None:
    """Return the time by the machine's clock, or None if it was never set."""
    now_unix_s = time.time()
    return now_unix_s if now_unix_s >= CLOCK_SET_UNIX_S else None


def no_clock() -> None:
    """Return that the time is not known, for a car whose clock cannot be trusted."""


@dataclass(frozen=True, slots=True)
class KeyPlaces:
    """Where the files lie; a folder stands for the `.pem` files in it.

    Attributes:
        credentials: Private keys with their certificates: the car's pseudonyms.
        authorities: Public keys of the authorities whose certificates count.
        revocations: The list of revoked certificates.
    """

    credentials: tuple[Path, ...] = ()
    authorities: tuple[Path, ...] = ()
    revocations: Path | None = None

    def read(self) -> TrustFiles:
        """Return the files as they are now.

        Raises:
            ConfigurationError: One cannot be read, or a folder holds none.
        """
        return TrustFiles(
            credentials=_files_in(self.credentials),
            authorities=_files_in(self.authorities),
            revocations=None if self.revocations is None else _file_of(self.revocations),
        )


NO_PLACES = KeyPlaces()


class Keys:
    """The keys of one vehicle, as its files said when they were last looked at."""

    def __init__(
        self, places: KeyPlaces = NO_PLACES, *, unix_s: Callable[[], float | None] = wall_clock_unix_s
    ) -> None:
        """Read the files.

        Args:
            places: Where they are; without any the vehicle sends unsigned and believes everybody.
            unix_s: The vehicle's wall clock, or None while it cannot be trusted.

        Raises:
            ConfigurationError: A file cannot be read or holds something else; the message names it.
        """
        self._places = places
        self._unix_s = unix_s
        self._trust = _vehicle_trust(places, None)

    @property
    def verifier(self) -> Verifier | None:
        """The units that are believed; None believes everybody, others nobody who does not sign."""
        return self._trust.verifier

    @property
    def pseudonyms_count(self) -> int:
        """Pseudonyms that may be used now."""
        now_unix_s = self._unix_s()
        return sum(now_unix_s is None or s.certificate.in_date(now_unix_s) for s in self._trust.signers)

    def renew(self) -> bool:
        """Return whether the files say something new, and go by it from the next exchange on.

        Raises:
            ConfigurationError: A file cannot be read or holds something else. What was known stays in use.
        """
        before, self._trust = self._trust, _vehicle_trust(self._places, self._trust)
        return self._trust is not before

    def codecs_for(self, section_id: str, *, speedup_ratio: float = 1.0) -> Callable[[bytes], WireCodec]:
        """Return what makes the codec of an exchange about a section from a passage's id.

        Args:
            section_id: The section.
            speedup_ratio: How fast the exchange's clock runs.
        """

        def open_codec(passage_id: bytes) -> WireCodec:
            trust = self._trust
            return WireCodec(
                passage_id,
                section_id=section_id,
                timeout_s=INCOMPLETE_WALL_S * speedup_ratio,
                signer=signer_for(trust.signers, passage_id=passage_id, now_unix_s=self._unix_s()),
                verifier=trust.verifier,
                unix_s=self._unix_s,
            )

        return open_codec


def read_keys(
    credentials: Sequence[Path] = (),
    authorities: Sequence[Path] = (),
    revocations: Path | None = None,
    *,
    unix_s: Callable[[], float | None] = wall_clock_unix_s,
) -> Keys:
    """Return the keys in files and folders; with an authority, unsigned answers are not believed.

    Raises:
        ConfigurationError: A file cannot be read or holds something else; the message names it.
    """
    return Keys(KeyPlaces(tuple(credentials), tuple(authorities), revocations), unix_s=unix_s)


def _vehicle_trust(places: KeyPlaces, previous: Trust | None) -> Trust:
    trust = trust_in(places.read(), previous=previous)
    for file, signer in zip(trust.files.credentials, trust.signers, strict=True):
        if signer.certificate.role is not Role.VEHICLE:
            raise ConfigurationError(f"{file.name}: the certificate is that of a {signer.certificate.role.value}")
    return trust


def _files_in(places: tuple[Path, ...]) -> tuple[NamedFile, ...]:
    files: list[NamedFile] = []
    for place in places:
        inside = sorted(place.glob("*.pem")) if place.is_dir() else [place]
        if not inside:
            raise ConfigurationError(f"{place}: no file NAME.pem in this folder")
        files += map(_file_of, inside)
    return tuple(files)


def _file_of(path: Path) -> NamedFile:
    try:
        return NamedFile(str(path), path.read_bytes())
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror or error}") from error
