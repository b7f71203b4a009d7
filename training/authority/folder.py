"""An authority on a disk::

keys/authority-1.pem           private key, mode 0600; the newest signs. This folder never leaves the authority
public/authority-1.pem         its public key: for the authorities folder of units and vehicles
register.jsonl                 what was issued and revoked, an event a line
issued/units/NAME.pem          credential of a unit, mode 0600: brought to it, then deleted here
issued/pseudonyms/NAME/01.pem  a batch of pseudonyms, mode 0600: brought to a vehicle, then deleted here
revoked.cose                   the signed list of revoked certificates, for units and vehicles
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from roadgrip.certificates import (
    CERTIFICATE_ID_BYTES,
    Certificate,
    RevocationList,
    Role,
    certificate_to_pem,
    issue_certificate,
    issue_revocations,
)
from roadgrip.errors import ConfigurationError, WireError
from roadgrip.sign1 import key_id_of, private_key_in, public_key_in
from roadgrip.signing import Signer
from roadgrip.trust import credential_to_pem
from training.authority.register import Entry, entries_in, issued_event, revoked_event

HOUR_S = 3_600
DAY_S = 86_400
PRIVATE_MODE = 0o600
PRIVATE_FOLDER_MODE = 0o700
NAME = re.compile(r"[a-z0-9][a-z0-9.-]{0,63}")

RandomBytes = Callable[[int], bytes]


@dataclass(frozen=True, slots=True)
class IssuedFile:
    """A certificate and the file that it was written to."""

    certificate: Certificate
    path: Path


@dataclass(frozen=True, slots=True)
class AuthorityFolder:
    """Where an authority keeps what it has.

    Attributes:
        root: The folder.
        password: Opens its private keys, if they are encrypted.
    """

    root: Path
    password: bytes | None = None

    @property
    def public_folder(self) -> Path:
        """The public keys."""
        return self.root / "public"

    @property
    def revocations_path(self) -> Path:
        """The list of revoked certificates."""
        return self.root / "revoked.cose"

    @property
    def _register_path(self) -> Path:
        return self.root / "register.jsonl"

    def begin(self) -> Path:
        """Return the public key of a new authority, in a folder that is empty or new.

        Raises:
            ConfigurationError: There is something already.
        """
        if self.root.exists() and (not self.root.is_dir() or any(self.root.iterdir())):
            raise ConfigurationError(f"{self.root} is not empty; an authority begins in a folder of its own")
        self.root.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER_MODE)
        self._register_path.touch(exist_ok=False)
        return self.new_key()

    def new_key(self) -> Path:
        """Return the public key of a new pair, which signs from now on; those before stay valid."""
        self._check()
        for folder in (self.root / "keys", self.public_folder):
            folder.mkdir(exist_ok=True, mode=PRIVATE_FOLDER_MODE)
        number = max((_number_of(path) for path in self.public_keys()), default=0) + 1
        private_key = Ed25519PrivateKey.generate()
        encryption = NoEncryption() if self.password is None else BestAvailableEncryption(self.password)
        _write_private(
            self.root / "keys" / f"authority-{number}.pem",
            private_key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption),
        )
        public = self.public_folder / f"authority-{number}.pem"
        public.write_bytes(private_key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
        return public

    def public_keys(self) -> list[Path]:
        """Return the files of the public keys, oldest first."""
        return sorted(self.public_folder.glob("authority-*.pem"), key=_number_of)

    def key_ids(self) -> dict[str, Path]:
        """Return the files of the public keys by their ids, oldest first."""
        return {key_id_of(public_key_in(path.read_bytes())).hex(): path for path in self.public_keys()}

    def entries(self) -> dict[str, Entry]:
        """Return what was issued, by id.

        Raises:
            ConfigurationError: There is no authority, or its register is damaged.
        """
        self._check()
        return entries_in(self._register_path.read_text(encoding="utf-8").splitlines())

    def issue_unit(
        self,
        name: str,
        *,
        section_ids: tuple[str, ...],
        days_count: int,
        now_unix_s: int,
        random_bytes: RandomBytes,
        public_key: Path | None = None,
    ) -> IssuedFile:
        """Return the credential of a unit, or its certificate alone if the unit keeps its private key to itself.

        Args:
            name: Of the unit, for the register and the file.
            section_ids: The sections it may speak for; empty: all.
            days_count: How long the certificate holds.
            now_unix_s: Now; the certificate begins at the full hour before.
            random_bytes: Gives the certificate's id.
            public_key: The unit's own public key (PEM); left out, a pair is made.

        Raises:
            ConfigurationError: The name or a section is none, or the file is there.
        """
        path = self.root / "issued" / "units" / f"{_checked_name(name)}.pem"
        private_key = None if public_key is not None else Ed25519PrivateKey.generate()
        holder = private_key.public_key() if private_key is not None else _public_key_at(public_key)
        start_unix_s = now_unix_s - now_unix_s % HOUR_S
        certificate = self._certificate(
            holder.public_bytes_raw(),
            role=Role.UNIT,
            section_ids=section_ids,
            start_unix_s=start_unix_s,
            end_unix_s=start_unix_s + days_count * DAY_S,
            certificate_id=random_bytes(CERTIFICATE_ID_BYTES),
        )
        if private_key is None:
            content = certificate_to_pem(certificate)
        else:
            content = credential_to_pem(Signer(certificate, private_key))
        _write_private(path, content)
        self._note([issued_event(certificate, name=name, now_unix_s=now_unix_s)])
        return IssuedFile(certificate, path)

    def issue_pseudonyms(
        self, name: str, *, count: int, days_count: int, start_unix_s: int, now_unix_s: int, random_bytes: RandomBytes
    ) -> list[IssuedFile]:
        """Return a batch of pseudonyms. All batches of a day have the same dates, so these tell nobody apart.

        Args:
            name: Of the batch, for the register and the folder; it should not name a vehicle.
            count: How many.
            days_count: How long they hold.
            start_unix_s: From when; they begin at midnight before.
            now_unix_s: Now.
            random_bytes: Gives their ids.

        Raises:
            ConfigurationError: The name is none, or the folder is there.
        """
        folder = self.root / "issued" / "pseudonyms" / _checked_name(name)
        if folder.exists():
            raise ConfigurationError(f"{folder} is there already; take another name")
        midnight_unix_s = start_unix_s - start_unix_s % DAY_S
        issued, events = [], []
        for number in range(1, count + 1):
            private_key = Ed25519PrivateKey.generate()
            certificate = self._certificate(
                private_key.public_key().public_bytes_raw(),
                role=Role.VEHICLE,
                section_ids=(),
                start_unix_s=midnight_unix_s,
                end_unix_s=midnight_unix_s + days_count * DAY_S,
                certificate_id=random_bytes(CERTIFICATE_ID_BYTES),
            )
            path = folder / f"{number:0{len(str(count))}}.pem"
            _write_private(path, credential_to_pem(Signer(certificate, private_key)))
            events.append(issued_event(certificate, name=name, now_unix_s=now_unix_s))
            issued.append(IssuedFile(certificate, path))
        self._note(events)
        return issued

    def revoke(self, entries: list[Entry], *, why: str, now_unix_s: int) -> list[Entry]:
        """Return the certificates that were not revoked before and are from now on; the next list will say so."""
        news = [entry for entry in entries if entry.revoked_unix_s is None]
        self._note([revoked_event(entry.certificate_id, why=why, now_unix_s=now_unix_s) for entry in news])
        return news

    def publish(self, *, days_count: int, now_unix_s: int) -> RevocationList:
        """Return the new list of revoked certificates, after it was written. What has ended by itself is left out.

        Raises:
            ConfigurationError: The list is longer than may be.
        """
        revoked = RevocationList(
            issued_unix_s=now_unix_s,
            due_unix_s=now_unix_s + days_count * DAY_S,
            certificate_ids=frozenset(
                bytes.fromhex(entry.certificate_id)
                for entry in self.entries().values()
                if entry.revoked_unix_s is not None and entry.valid_until_unix_s >= now_unix_s
            ),
        )
        try:
            encoded = issue_revocations(revoked, authority=self._private_key())
        except WireError as error:
            raise ConfigurationError(error.detail) from error
        beside = self.revocations_path.with_suffix(".new")
        beside.write_bytes(encoded)
        beside.replace(self.revocations_path)
        return revoked

    def _certificate(
        self,
        public_key: bytes,
        *,
        role: Role,
        section_ids: tuple[str, ...],
        start_unix_s: int,
        end_unix_s: int,
        certificate_id: bytes,
    ) -> Certificate:
        try:
            return issue_certificate(
                public_key,
                authority=self._private_key(),
                certificate_id=certificate_id,
                role=role,
                section_ids=section_ids,
                valid_from_unix_s=start_unix_s,
                valid_until_unix_s=end_unix_s,
            )
        except WireError as error:
            raise ConfigurationError(error.detail) from error

    def _private_key(self) -> Ed25519PrivateKey:
        self._check()
        newest = self.public_keys()[-1]
        path = self.root / "keys" / newest.name
        try:
            return private_key_in(path.read_bytes(), password=self.password)
        except (OSError, ConfigurationError) as error:
            raise ConfigurationError(f"{path}: {error}") from error

    def _note(self, events: list[dict[str, Any]]) -> None:
        with self._register_path.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(event) + "\n" for event in events)
            file.flush()
            os.fsync(file.fileno())

    def _check(self) -> None:
        if not self._register_path.is_file():
            raise ConfigurationError(f"{self.root} holds no authority; `roadgrip-authority init` begins one")


def _number_of(path: Path) -> int:
    number = path.stem.rpartition("-")[2]
    return int(number) if number.isdecimal() else 0


def _checked_name(name: str) -> str:
    if not NAME.fullmatch(name):
        raise ConfigurationError(f"{name!r} is no name: lower-case letters, digits, hyphens and points, at most 64")
    return name


def _public_key_at(path: Path | None) -> Any:
    assert path is not None  # noqa: S101 - for the type checker: asked for only where there is one
    try:
        return public_key_in(path.read_bytes())
    except (OSError, ConfigurationError) as error:
        raise ConfigurationError(f"{path}: {error}") from error


def _write_private(path: Path, content: bytes) -> None:
    """Write a file of the owner alone: never a moment in which others could read it, never over another one."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=PRIVATE_FOLDER_MODE)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_MODE)
    except FileExistsError as error:
        raise ConfigurationError(f"{path} is there already; take another name, or move it away") from error
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
