"""One visit to a repository with python-tuf, which is imported here and in `fetching`, and nowhere else on a unit."""

from __future__ import annotations

import logging
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

from tuf.api.exceptions import (
    BadVersionNumberError,
    DownloadError,
    DownloadLengthMismatchError,
    ExpiredMetadataError,
    LengthOrHashMismatchError,
    RepositoryError,
    UnsignedMetadataError,
)
from tuf.api.metadata import TargetFile
from tuf.ngclient.updater import Updater

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.errors import RoadgripError
from roadgrip.release import (
    METADATA_FOLDER,
    TARGETS_FOLDER,
    Release,
    ReleaseError,
    bundle_target,
    release_from_json,
    ring_target,
)
from rsu_app.adapters.updates.fetching import AddressError, BoundedFetcher, fetcher_for
from rsu_app.adapters.updates.limits import FetchLimits
from rsu_app.adapters.updates.shelf import NO_ROOM_ERRNOS, make_folder
from rsu_app.rollout_ports import FetchedRelease, UpdateReason, UpdateRefusal

POINTER_LIMIT_BYTES = 64 * 1024
"""A larger pointer of a ring is none."""

# Both tell every step at INFO; what matters comes back as a refusal.
for _chatty in ("tuf", "securesystemslib"):
    logging.getLogger(_chatty).setLevel(logging.WARNING)


class _RefusedError(RoadgripError):
    """Carries a refusal to the door of the visit, where it becomes a value."""

    def __init__(self, reason: UpdateReason, detail: str) -> None:
        super().__init__(detail)
        self.refusal = UpdateRefusal(reason, detail)


class Visit:
    """A visit: brings the metadata up to date, reads a ring's pointer, fetches the files it names.

    Args:
        address: See `rsu_app.adapters.updates.repository.TufReleaseSource`, also for the others.
        trusted_root: The content of its file.
        cache_folder: Where python-tuf remembers.
        limits: What the visit may take.
    """

    def __init__(self, address: str, *, trusted_root: bytes, cache_folder: Path, limits: FetchLimits) -> None:
        self._address = address
        self._trusted_root = trusted_root
        self._cache_folder = cache_folder
        self._limits = limits

    def fetch(self, ring: str, *, newer_than: int, into: Path) -> FetchedRelease | UpdateRefusal | None:
        """Return what `TufReleaseSource.fetch` promises."""
        try:
            fetcher = fetcher_for(self._address, silence_s=self._limits.silence_s, total_s=self._limits.total_s)
        except AddressError as error:
            return UpdateRefusal(UpdateReason.NOT_CONFIGURED, str(error))
        try:
            updater = self._up_to_date(fetcher)
            release = _release_of(ring, updater)
            if release.sequence_number == newer_than:
                return None
            self._bring(_news(release, newer_than=newer_than), updater, into)
            return FetchedRelease(release, into)
        except _RefusedError as refused:
            return refused.refusal
        except (RepositoryError, DownloadError, OSError) as error:
            return _refusal_of(error, fetcher)

    def _up_to_date(self, fetcher: BoundedFetcher) -> Updater:
        try:
            return self._refreshed(fetcher)
        except OSError as error:
            if error.errno in NO_ROOM_ERRNOS:
                raise
        # A cut has left something in the cache that python-tuf can neither read nor write over; damaged content alone
        # it fetches anew. Starting over with the trusted root forgets which metadata was the newest. An older
        # repository is then refused only by the number of its release, for which the caller's state stands.
        self._forget()
        return self._refreshed(fetcher)

    def _refreshed(self, fetcher: BoundedFetcher) -> Updater:
        self._cache_folder.mkdir(parents=True, exist_ok=True)
        # python-tuf writes to temporary files first; a kill leaves one behind each time.
        for litter in self._cache_folder.glob("tmp*"):
            with suppress(OSError):
                litter.unlink()
        try:
            updater = Updater(
                str(self._cache_folder),
                METADATA_FOLDER,
                target_base_url=TARGETS_FOLDER,
                fetcher=fetcher,
                bootstrap=self._trusted_root,
            )
        except RepositoryError as error:
            raise _RefusedError(
                UpdateReason.NOT_CONFIGURED,
                f"the trusted root is damaged ({error}): bring the laboratory's trusted-root.json again",
            ) from error
        updater.refresh()
        return updater

    def _forget(self) -> None:
        if self._cache_folder.is_dir() and not self._cache_folder.is_symlink():
            shutil.rmtree(self._cache_folder)
        else:
            self._cache_folder.unlink(missing_ok=True)

    def _bring(self, release: Release, updater: Updater, into: Path) -> None:
        targets = _targets_of(release, updater, self._limits)
        shutil.rmtree(into, ignore_errors=True)
        try:
            make_folder(into)
            for name, target in targets.items():
                updater.download_target(target, str(into / name))
        except BaseException:
            # Half a bundle is worth nothing and takes room.
            shutil.rmtree(into, ignore_errors=True)
            raise


def _release_of(ring: str, updater: Updater) -> Release:
    try:
        path = ring_target(ring)
    except ReleaseError as error:
        raise _RefusedError(UpdateReason.NOT_CONFIGURED, str(error)) from error
    target = updater.get_targetinfo(path)
    if target is None:
        raise _RefusedError(UpdateReason.NO_RELEASE, f"the repository has no release for ring {ring}")
    if target.length > POINTER_LIMIT_BYTES:
        raise _RefusedError(UpdateReason.MALFORMED, f"{path} has {target.length} bytes, more than a release can have")
    with tempfile.TemporaryDirectory() as folder:
        content = Path(updater.download_target(target, str(Path(folder, "release.json")))).read_bytes()
    try:
        release = release_from_json(content.decode())
    except (ReleaseError, UnicodeDecodeError, RecursionError) as error:
        raise _RefusedError(UpdateReason.MALFORMED, f"{path}: {error}; the laboratory has to release anew") from error
    if release.ring != ring:
        raise _RefusedError(UpdateReason.TAMPERED, f"the pointer of ring {ring} is one of ring {release.ring}")
    return release


def _news(release: Release, *, newer_than: int) -> Release:
    if release.sequence_number < newer_than:
        raise _RefusedError(
            UpdateReason.DOWNGRADE,
            f"ring {release.ring} runs release {release.sequence_number}, this unit knows release {newer_than};"
            " a step back is a new release of the old bundle",
        )
    return release


def _targets_of(release: Release, updater: Updater, limits: FetchLimits) -> dict[str, TargetFile]:
    """Return the files of a release's bundle as they are signed, if it can be one.

    Raises:
        _RefusedError: It cannot.
    """
    subject = f"release {release.sequence_number} of bundle {release.bundle_id}"
    if MANIFEST_NAME not in release.files_sha256:
        raise _RefusedError(UpdateReason.MALFORMED, f"{subject} names no {MANIFEST_NAME}")
    if len(release.files_sha256) > limits.files_count:
        raise _RefusedError(
            UpdateReason.UNUSABLE_BUNDLE,
            f"{subject} has {len(release.files_sha256)} files; this unit takes {limits.files_count}",
        )
    targets: dict[str, TargetFile] = {}
    for name, digest in release.files_sha256.items():
        target = updater.get_targetinfo(bundle_target(release.bundle_id, name))
        if target is None:
            raise _RefusedError(UpdateReason.MALFORMED, f"{subject} names {name}, which the repository does not hold")
        if target.hashes.get("sha256") != digest:
            raise _RefusedError(
                UpdateReason.TAMPERED, f"{subject}: the repository holds another {name} than the released"
            )
        targets[name] = target
    size_bytes = sum(target.length for target in targets.values())
    if size_bytes > limits.bundle_bytes:
        raise _RefusedError(
            UpdateReason.UNUSABLE_BUNDLE, f"{subject} has {size_bytes} bytes; this unit takes {limits.bundle_bytes}"
        )
    return targets


def _refusal_of(error: Exception, fetcher: BoundedFetcher) -> UpdateRefusal:
    """Return what an error of python-tuf, of the network or of the disk means to an operator."""
    reason, advice = _meaning_of(error, fetcher)
    said = str(error) or type(error).__name__
    return UpdateRefusal(reason, f"{said}: {advice}")


def _meaning_of(error: Exception, fetcher: BoundedFetcher) -> tuple[UpdateReason, str]:
    copy_again = "not the file that was signed; if the repository was copied, copy it again"
    match error:
        case ExpiredMetadataError():
            return UpdateReason.EXPIRED, "have the laboratory sign it anew, or set this machine's clock right"
        case UnsignedMetadataError():
            return UpdateReason.BAD_SIGNATURE, "not signed by those whom this unit's trusted root names"
        case BadVersionNumberError() if not fetcher.holds_another_version():
            return UpdateReason.DOWNGRADE, "older than what this unit has seen; a mirror may be behind"
        case BadVersionNumberError() | LengthOrHashMismatchError() | DownloadLengthMismatchError():
            return UpdateReason.TAMPERED, copy_again
        case RepositoryError():
            return UpdateReason.MALFORMED, "no metadata that this software can read"
        case DownloadError():
            return UpdateReason.UNREACHABLE, "is it the right address, and the repository whole?"
        case _:
            return UpdateReason.NO_ROOM, "this unit cannot keep what it fetches; make room, or look at its disk"
