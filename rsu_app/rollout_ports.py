"""What a rollout needs from the world: a shelf that survives power cuts, and a place where releases come from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from roadgrip.release import Release
from rsu_app.domain.rollout import RolloutState, ShelvedBundle


class UpdateReason(StrEnum):
    """Why a release was not taken. The operator sees it, the metric counts it, the documentation lists it."""

    NOT_CONFIGURED = "not_configured"
    UNREACHABLE = "unreachable"
    CLOCK = "clock"
    EXPIRED = "expired"
    BAD_SIGNATURE = "bad_signature"
    DOWNGRADE = "downgrade"
    TAMPERED = "tampered"
    MALFORMED = "malformed"
    NO_RELEASE = "no_release"
    UNUSABLE_BUNDLE = "unusable_bundle"
    NO_ROOM = "no_room"


@dataclass(frozen=True, slots=True)
class UpdateRefusal:
    """A release that was not taken, and why; whatever ran goes on running."""

    reason: UpdateReason
    detail: str


@dataclass(frozen=True, slots=True)
class FetchedRelease:
    """A release whose signatures hold, with the folder that its files were brought to.

    Attributes:
        release: What the ring shall run.
        folder: Its files, each with the digest that was signed; None when the caller had said that it needs none.
    """

    release: Release
    folder: Path | None


class ReleaseSource(Protocol):
    """A signed repository: a folder, or a web server. Blocking; call it on another thread."""

    def fetch(self, ring: str, *, newer_than: int, into: Path) -> FetchedRelease | UpdateRefusal | None:
        """Return the release of a ring with its files, None if it is no news, or why it must not be taken.

        Args:
            ring: The unit's own.
            newer_than: Sequence number of the newest release the unit knows; the files of others are not fetched. A
                ring whose release is older than that is a downgrade.
            into: Folder for the files; emptied first, made if missing.
        """
        ...


class BundleShelf(Protocol):
    """Bundles by id, and one small file that says which is for what. Blocking; call it on another thread.

    Whatever is on the shelf was whole when it was put there, and is looked at again whenever it is opened.
    """

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about how the state was read, such as a damaged file that was moved aside."""
        ...

    def state(self) -> RolloutState:
        """Return what the shelf is for; the factory's bundle alone if there is no shelf yet or its file is damaged."""
        ...

    def keep_state(self, state: RolloutState) -> None:
        """Return once the state is on the disk, whole; the old one stays if that fails.

        Raises:
            StoreError: It cannot be written.
        """
        ...

    def put(self, release: Release, folder: Path) -> ShelvedBundle:
        """Move a fetched bundle onto the shelf and return it; on the disk when this returns. Changes no state.

        Raises:
            StoreError: There is no room, or it cannot be written.
            BundleError: Its files are not the release's.
        """
        ...

    def folder_of(self, bundle: ShelvedBundle) -> Path:
        """Return where a bundle lies, after its files were held against its manifest and that against its digest.

        Raises:
            BundleError: It is not there, or not what was put there.
        """
        ...

    def clear(self, state: RolloutState) -> None:
        """Remove what a state does not need, interrupted work among it. Never raises for the disk's sake."""
        ...

    @property
    def incoming_folder(self) -> Path:
        """A place on the shelf's own file system for files on their way; may not exist, and is worth nothing."""
        ...
