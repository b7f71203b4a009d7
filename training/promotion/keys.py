"""Key files, one Ed25519 key each, in folders that their holders keep: PKCS#8 PEM, encrypted or not."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from securesystemslib.signer import CryptoSigner

from roadgrip.errors import RoadgripError

OFFLINE_ROLES = ("root", "targets")
"""What units trust: who may sign at all, and which bundles there are. Their keys lie in a safe."""
ONLINE_ROLES = ("snapshot", "timestamp")
"""What says that the above is of today. Their keys stay with the machine that refreshes."""
ROLES = (*OFFLINE_ROLES, *ONLINE_ROLES)
TRUSTED_ROOT_NAME = "trusted-root.json"
"""Lies in the repository for technicians, and beside the keys so that their holders know their own repository."""
PRIVATE_MODE = 0o600


class KeysError(RoadgripError):
    """Keys that cannot be used, made or taken away as asked; the message says why."""


@dataclass(frozen=True, slots=True)
class SigningKeys:
    """The key files somebody has at hand.

    Attributes:
        folders: Where they lie.
        passwords: Each is tried on each encrypted key.
    """

    folders: tuple[Path, ...]
    passwords: tuple[bytes, ...] = ()

    def of_role(self, role: str) -> dict[str, CryptoSigner]:
        """Return what can sign for a role, by key id; whether a root names these keys is not asked here.

        Raises:
            KeysError: A folder is missing, or a key cannot be read, for want of its password perhaps.
        """
        return {signer.public_key.keyid: signer for _, signer in self._read(role)}

    def files_of_role(self, role: str) -> dict[str, Path]:
        """Return where the keys of a role lie, by key id.

        Raises:
            KeysError: See `of_role`.
        """
        return {signer.public_key.keyid: path for path, signer in self._read(role)}

    def _read(self, role: str) -> Iterator[tuple[Path, CryptoSigner]]:
        for folder in self.folders:
            if not folder.is_dir():
                raise KeysError(f"there is no folder of keys {folder}")
            for path in sorted(folder.glob(f"{role}-*.pem")):
                yield path, read_key(path, passwords=self.passwords)

    def check(self, roles: Iterable[str]) -> None:
        """Do nothing if every key of some roles can be read; before anything is written that would need them.

        Raises:
            KeysError: One cannot.
        """
        for role in roles:
            self.of_role(role)

    def trusted_roots(self) -> Mapping[Path, bytes]:
        """Return the trusted roots that lie beside the keys."""
        paths = [folder / TRUSTED_ROOT_NAME for folder in self.folders]
        return {path: path.read_bytes() for path in paths if path.is_file()}


def make_key(folder: Path, role: str, *, password: bytes | None) -> tuple[Path, CryptoSigner]:
    """Return a new key and the file it was written to, the next free number of its role.

    Args:
        folder: Made if missing, for its owner only.
        role: Part of the file's name.
        password: Encrypts the file.
    """
    if password == b"":
        raise KeysError("the password is empty")
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    taken = [int(number) for path in folder.glob(f"{role}-*.pem") if (number := path.stem.split("-", 1)[1]).isdigit()]
    path = folder / f"{role}-{max(taken, default=0) + 1}.pem"
    private_key = Ed25519PrivateKey.generate()
    encryption = NoEncryption() if password is None else BestAvailableEncryption(password)
    content = private_key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, encryption)
    # Never a moment in which somebody else could read it, and never over another key.
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE_MODE), "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return path, CryptoSigner(private_key)


def read_key(path: Path, *, passwords: Sequence[bytes] = ()) -> CryptoSigner:
    """Return what signs with a key file.

    Raises:
        KeysError: It is no Ed25519 key, or is encrypted and no password opens it.
    """
    content = path.read_bytes()
    encrypted = b"ENCRYPTED" in content
    if encrypted and not passwords:
        raise KeysError(f"{path} is encrypted: give --password-file")
    for password in passwords if encrypted else (None,):
        try:
            private_key = load_pem_private_key(content, password)
        except (ValueError, TypeError, UnsupportedAlgorithm) as error:
            if encrypted:
                continue
            raise KeysError(f"{path} is no key: {error}") from error
        if not isinstance(private_key, Ed25519PrivateKey):
            raise KeysError(f"{path} is no Ed25519 key")
        return CryptoSigner(private_key)
    raise KeysError(f"{path}: the password is wrong, or the file is damaged")


def read_password(path: Path) -> bytes:
    """Return the first line of a file.

    Raises:
        KeysError: It is empty.
    """
    password = path.read_bytes().split(b"\n", 1)[0].rstrip(b"\r")
    if not password:
        raise KeysError(f"{path} holds no password in its first line")
    return password
