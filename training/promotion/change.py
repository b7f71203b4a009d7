"""A change of root or targets: signed by one holder of keys after another, and published when nothing is missing.

Every change goes through one file, `staged/change.json`, which is always whole. What units read is touched only once
all signatures are there, the timestamp last, so that an interrupted publication leaves the old state or is finished by
the next command that signs.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from securesystemslib.signer import Signer
from tuf.api.metadata import Metadata, MetaFile, Root, Snapshot, Targets, Timestamp
from tuf.api.metadata import VerificationResult as Signatures

from roadgrip.release import Release, ReleaseError, release_from_json, release_to_json
from training.promotion.keys import ONLINE_ROLES, ROLES, KeysError, SigningKeys
from training.promotion.repository import (
    KEPT_VERSIONS_COUNT,
    Published,
    Repository,
    RepositoryFolderError,
    bundle_ids,
    expiry,
    read_metadata,
    write_whole,
)

CHANGE_FORMAT_VERSION = 1
SHORT_ID_CHARS = 12
_Online = TypeVar("_Online", Snapshot, Timestamp)


@dataclass(frozen=True, slots=True)
class Change:
    """What shall be published.

    Attributes:
        what: For people; it is not signed, so nobody should sign on the strength of it.
        root: The next root, if it changes.
        targets: The next targets, if they change.
        release: The release that the new targets bring, if they do.
        tidies: Whether files that nothing is signed about shall go when it is published.
    """

    what: str
    root: Metadata[Root] | None = None
    targets: Metadata[Targets] | None = None
    release: Release | None = None
    tidies: bool = False


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a change.

    Attributes:
        what: Of the change.
        missing: The signatures it waits for, a line each; published if there are none.
        release: Of the change.
    """

    what: str
    missing: tuple[str, ...] = ()
    release: Release | None = None

    @property
    def published(self) -> bool:
        """Whether units can read it."""
        return not self.missing


def staged_change(repository: Repository) -> Change | None:
    """Return the change that waits for signatures; None without one.

    Raises:
        RepositoryFolderError: The file is damaged.
    """
    if not repository.change_path.is_file():
        return None
    try:
        raw: dict[str, Any] = json.loads(repository.change_path.read_text(encoding="utf-8"))
        if raw["format_version"] != CHANGE_FORMAT_VERSION:
            raise RepositoryFolderError(f"{repository.change_path} has format {raw['format_version']}")
        return Change(
            what=str(raw["what"]),
            root=None if raw["root"] is None else Metadata.from_dict(raw["root"]),
            targets=None if raw["targets"] is None else Metadata.from_dict(raw["targets"]),
            release=None if raw["release"] is None else release_from_json(json.dumps(raw["release"])),
            tidies=bool(raw["tidies"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, ReleaseError) as error:
        raise RepositoryFolderError(
            f"{repository.change_path} is damaged ({error}): `roadgrip-train sign --withdraw REASON` drops it"
        ) from error


def refuse_second_change(repository: Repository) -> None:
    """Do nothing if no change waits for signatures.

    Raises:
        RepositoryFolderError: One does.
    """
    waiting = staged_change(repository)
    if waiting is not None:
        raise RepositoryFolderError(
            f"a change waits for signatures: {waiting.what}; `roadgrip-train sign --keys FOLDER` goes on with it, "
            "`roadgrip-train sign --withdraw REASON` drops it"
        )


def refuse_foreign_repository(repository: Repository, keys: SigningKeys) -> None:
    """Do nothing if the repository begins with the root that lies beside the keys, if one does.

    Whoever replaces every file of a repository can make its chain of roots look right; what lies in the safe tells.

    Raises:
        KeysError: It does not.
    """
    first = repository.root_path(1)
    for path, trusted in keys.trusted_roots().items():
        if not first.is_file() or first.read_bytes() != trusted:
            raise KeysError(f"{path} is not how {repository.folder} begins: these keys are another repository's")


def advance(repository: Repository, change: Change, keys: SigningKeys, *, now_unix_s: float) -> Outcome:
    """Return what became of a change after every fitting key at hand has signed it; call it with the lock held.

    Raises:
        KeysError: A key cannot be read, or belongs to another repository; nothing was changed.
        RepositoryFolderError: The change was made for another state of the repository.
    """
    refuse_foreign_repository(repository, keys)
    if _is_published(repository, change):  # the last command was interrupted when all but this was done
        return _end(repository, change)
    base = _base(repository, change)
    _refuse_stale(base, change)
    root = base.root if change.root is None else change.root
    _sign(base.root.signed, root.signed, change, keys)
    online = {role: _fitting(root.signed, role, keys) for role in ONLINE_ROLES}
    write_whole(repository.change_path, _to_json(change).encode())
    missing = (*_missing(base.root.signed, root.signed, change), *_missing_online(root.signed, online))
    if missing:
        return Outcome(change.what, missing, change.release)
    targets = base.targets if change.targets is None else change.targets
    content = None if change.targets is None else change.targets.to_bytes()
    # What nobody reads yet comes first, and the timestamp, which leads there, last.
    if content is not None:
        write_whole(repository.metadata_folder / f"{targets.signed.version}.targets.json", content)
    publish_online(
        repository,
        Published(root, targets, base.snapshot, base.timestamp),
        online,
        new_root=None if change.root is None else change.root.to_bytes(),
        now_unix_s=now_unix_s,
    )
    return _end(repository, change)


def sign(repository: Repository, keys: SigningKeys, *, now_unix_s: float) -> tuple[list[str], Outcome]:
    """Return what the waiting change changes, and what became of it after every fitting key at hand has signed it.

    Raises:
        KeysError: A key cannot be read, or belongs to another repository.
        RepositoryFolderError: No change waits, or it was made for another state of the repository.
    """
    with repository.locked():
        change = staged_change(repository)
        if change is None:
            raise RepositoryFolderError("no change waits for signatures")
        lines = [] if _is_published(repository, change) else differences(repository, change)
        return lines, advance(repository, change, keys, now_unix_s=now_unix_s)


def withdraw(repository: Repository) -> Change | None:
    """Return the change that was dropped, None if it was damaged; call it with the lock held.

    Raises:
        RepositoryFolderError: There is none, or units may have seen a part of it.
    """
    if not repository.change_path.is_file():
        raise RepositoryFolderError("no change waits for signatures")
    try:
        change = staged_change(repository)
    except RepositoryFolderError:
        change = None
    if change is not None and change.root is not None and _root_is_out(repository, change.root):
        raise RepositoryFolderError("units may have seen the new root: finish with `roadgrip-train sign`")
    repository.change_path.unlink()
    return change


def differences(repository: Repository, change: Change) -> list[str]:
    """Return what a change would change, read from what is signed, a line each; for whoever is asked to sign.

    Raises:
        RepositoryFolderError: The published state cannot be trusted, or a pointer is not what would be signed.
    """
    base = _base(repository, change)
    lines = [] if change.root is None else list(_root_differences(base.root.signed, change.root.signed))
    if change.targets is None:
        return lines
    before, after = base.targets.signed, change.targets.signed
    releases = repository.releases(before)
    lines += [
        f"ring {ring}: release {release.sequence_number}, bundle {release.bundle_id}, gate {release.gate}, "
        f"by {release.released_by}: {release.reason}"
        for ring, release in repository.releases(after).items()
        if releases.get(ring) != release
    ]
    lines += [f"ring {ring}: none any more" for ring in sorted(set(releases) - set(repository.releases(after)))]
    lines += [f"bundle {new}: new" for new in bundle_ids(after) if new not in bundle_ids(before)]
    lines += [f"bundle {old}: removed" for old in bundle_ids(before) if old not in bundle_ids(after)]
    lines += [
        f"file {path}: replaced"
        for path, target in after.targets.items()
        if path.startswith("bundles/") and path in before.targets and before.targets[path] != target
    ]
    return [*lines, f"targets {after.version}, good until {after.expires:%Y-%m-%d}"]


def refresh(repository: Repository, keys: SigningKeys, *, now_unix_s: float) -> Outcome:
    """Return what was published after snapshot and timestamp were signed anew.

    A change that is waiting for nothing but these two is published with them.

    Raises:
        KeysError: Not enough keys of these roles are at hand.
    """
    with repository.locked():
        change = staged_change(repository)
        if change is not None:
            outcome = advance(repository, change, keys, now_unix_s=now_unix_s)
            if outcome.published:
                return outcome
        refuse_foreign_repository(repository, keys)
        published = repository.published()
        online = {role: _fitting(published.root.signed, role, keys) for role in ONLINE_ROLES}
        missing = list(_missing_online(published.root.signed, online))
        if missing:
            raise KeysError(f"cannot refresh: {'; '.join(missing)}")
        publish_online(repository, published, online, new_root=None, now_unix_s=now_unix_s)
        return Outcome("snapshot and timestamp signed anew")


def publish_online(
    repository: Repository,
    state: Published,
    online: Mapping[str, Mapping[str, Signer]],
    *,
    new_root: bytes | None,
    now_unix_s: float,
) -> None:
    """Publish a root and targets that are signed in full: make the snapshot and the timestamp that lead there.

    Args:
        repository: Its lock is held, and the targets lie in it.
        state: The root and targets to publish, and the snapshot and timestamp until now.
        online: Who signs snapshot and timestamp, by role and key id.
        new_root: The root as it is to be written, if it is new.
        now_unix_s: Counts for the expiry.
    """
    root, folder = state.root.signed, repository.metadata_folder
    targets_version = state.targets.signed.version
    targets_content = (folder / f"{targets_version}.targets.json").read_bytes()
    snapshot = Snapshot(
        version=state.snapshot.signed.version + 1,
        expires=expiry(root, "snapshot", now_unix_s=now_unix_s),
        meta={"targets.json": MetaFile.from_data(targets_version, targets_content, ["sha256"])},
    )
    snapshot_content = _signed(snapshot, online["snapshot"])
    timestamp = Timestamp(
        version=state.timestamp.signed.version + 1,
        expires=expiry(root, "timestamp", now_unix_s=now_unix_s),
        snapshot_meta=MetaFile.from_data(snapshot.version, snapshot_content, ["sha256"]),
    )
    write_whole(folder / f"{snapshot.version}.snapshot.json", snapshot_content)
    if new_root is not None:
        write_whole(repository.root_path(root.version), new_root)
    write_whole(folder / "timestamp.json", _signed(timestamp, online["timestamp"]))
    for role, version in (("targets", targets_version), ("snapshot", snapshot.version)):
        for path in folder.glob(f"*.{role}.json"):
            number = path.name.split(".", 1)[0]
            if number.isdigit() and int(number) < version - KEPT_VERSIONS_COUNT:
                path.unlink()


def _signed(signed: _Online, signers: Mapping[str, Signer]) -> bytes:
    metadata = Metadata(signed)
    for signer in signers.values():
        metadata.sign(signer, append=True)
    return metadata.to_bytes()


def _fitting(root: Root, role: str, keys: SigningKeys) -> dict[str, Signer]:
    named = root.roles[role].keyids
    return {key_id: signer for key_id, signer in keys.of_role(role).items() if key_id in named}


def _sign(old_root: Root, root: Root, change: Change, keys: SigningKeys) -> None:
    if change.root is not None:
        # The old keys say that the new ones may follow them.
        for signer in (_fitting(old_root, "root", keys) | _fitting(root, "root", keys)).values():
            change.root.sign(signer, append=True)
    if change.targets is not None:
        for signer in _fitting(root, "targets", keys).values():
            change.targets.sign(signer, append=True)


def _missing(old_root: Root, root: Root, change: Change) -> Iterator[str]:
    if change.root is not None:
        both = root.get_root_verification_result(old_root, change.root.signed_bytes, change.root.signatures)
        yield from _lacking("root (its keys until now)", both.first)
        yield from _lacking("root (its keys from now on)", both.second)
    if change.targets is not None:
        yield from _lacking(
            "targets",
            root.get_verification_result("targets", change.targets.signed_bytes, change.targets.signatures),
        )


def _lacking(role: str, signatures: Signatures) -> Iterator[str]:
    if signatures.missing:
        yield _line(role, signatures.missing, list(signatures.unsigned))


def _missing_online(root: Root, online: Mapping[str, Mapping[str, Signer]]) -> Iterator[str]:
    for role, signers in online.items():
        missing = root.roles[role].threshold - len(signers)
        if missing > 0:
            yield _line(role, missing, [key_id for key_id in root.roles[role].keyids if key_id not in signers])


def _line(role: str, count: int, key_ids: list[str]) -> str:
    names = " or ".join(key_id[:SHORT_ID_CHARS] for key_id in sorted(key_ids))
    return f"{role}: {count} more signature{'s' if count > 1 else ''}, of {names}"


def _base(repository: Repository, change: Change) -> Published:
    """Return what was published before a change, also when its root is out and the rest is not."""
    return repository.published(root_version=None if change.root is None else change.root.signed.version - 1)


def _refuse_stale(base: Published, change: Change) -> None:
    if change.targets is not None and change.targets.signed.version != base.targets.signed.version + 1:
        raise RepositoryFolderError(
            f"the change was made for targets {change.targets.signed.version - 1}, the repository has "
            f"{base.targets.signed.version}: withdraw it and make it again"
        )


def _is_published(repository: Repository, change: Change) -> bool:
    if change.root is not None and not _root_is_out(repository, change.root):
        return False
    try:
        published = repository.published()
    except RepositoryFolderError:
        if change.root is None:
            raise
        return False  # a root is out whose timestamp is not
    return change.targets is None or change.targets.signed == published.targets.signed


def _root_is_out(repository: Repository, root: Metadata[Root]) -> bool:
    path = repository.root_path(root.signed.version)
    if not path.is_file():
        return False
    if read_metadata(path, Root).signed != root.signed:
        raise RepositoryFolderError(f"{path} is another root than the one of the change: withdraw it and make it again")
    return True


def _end(repository: Repository, change: Change) -> Outcome:
    if change.tidies:
        for path in repository.surplus_files(repository.published().targets.signed):
            path.unlink()
    repository.change_path.unlink(missing_ok=True)
    return Outcome(change.what, (), change.release)


def _root_differences(before: Root, after: Root) -> Iterator[str]:
    for role in ROLES:
        old, new = before.roles[role], after.roles[role]
        yield from (f"{role}: new key {key_id}" for key_id in new.keyids if key_id not in old.keyids)
        yield from (f"{role}: key {key_id} revoked" for key_id in old.keyids if key_id not in new.keyids)
        if old.threshold != new.threshold:
            yield f"{role}: threshold {old.threshold} becomes {new.threshold}"
    if before.unrecognized_fields != after.unrecognized_fields:
        yield f"the root says besides {json.dumps(after.unrecognized_fields, sort_keys=True)}"
    yield f"root {after.version}, good until {after.expires:%Y-%m-%d}"


def _to_json(change: Change) -> str:
    raw = {
        "format_version": CHANGE_FORMAT_VERSION,
        "what": change.what,
        "root": None if change.root is None else change.root.to_dict(),
        "targets": None if change.targets is None else change.targets.to_dict(),
        "release": None if change.release is None else json.loads(release_to_json(change.release)),
        "tidies": change.tidies,
    }
    return json.dumps(raw, indent=1, sort_keys=True) + "\n"
