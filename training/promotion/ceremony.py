"""The ceremonies of keys: a repository is begun, keys come and go, dates are renewed; each is written in the ledger."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from securesystemslib.signer import CryptoSigner
from tuf.api.metadata import Metadata, MetaFile, Root, Snapshot, Targets, Timestamp

from roadgrip.ledger import Action
from training.laboratory import Laboratory
from training.promotion.change import (
    SHORT_ID_CHARS,
    Change,
    Outcome,
    advance,
    refuse_foreign_repository,
    refuse_second_change,
)
from training.promotion.keys import ROLES, TRUSTED_ROOT_NAME, KeysError, SigningKeys, make_key
from training.promotion.repository import (
    PERIODS_FIELD,
    Published,
    Repository,
    RepositoryFolderError,
    expiry,
    write_whole,
)

DEFAULT_PERIODS: Mapping[str, int] = {"root": 365, "targets": 365, "snapshot": 45, "timestamp": 45}
"""Days that signed metadata lasts. 45: a stick that is carried up a mountain once a month must still be good."""
ALL_KEYS = "all"


@dataclass(frozen=True, slots=True)
class RoleKeys:
    """How a role begins.

    Attributes:
        keys_count: Keys that are made.
        threshold_count: How many of them must sign.
    """

    keys_count: int = 1
    threshold_count: int = 1


DEFAULT_ROLE_KEYS: Mapping[str, RoleKeys] = {
    "root": RoleKeys(keys_count=2),
    "targets": RoleKeys(),
    "snapshot": RoleKeys(),
    "timestamp": RoleKeys(),
}


@dataclass(frozen=True, slots=True)
class NewKey:
    """A key that was made.

    Attributes:
        role: What it signs.
        key_id: Its name in the root.
        path: Where it lies.
    """

    role: str
    key_id: str
    path: Path


def begin_repository(
    lab: Laboratory,
    keys_folder: Path,
    *,
    role_keys: Mapping[str, RoleKeys] = DEFAULT_ROLE_KEYS,
    periods: Mapping[str, int] = DEFAULT_PERIODS,
    password: bytes | None = None,
    by: str,
    now_unix_s: float,
) -> tuple[NewKey, ...]:
    """Return the keys that were made for a new, empty repository.

    Args:
        lab: Has none yet.
        keys_folder: Where the keys go; holds none yet. A copy of the first root is laid beside them.
        role_keys: How each role begins.
        periods: Days that the metadata of each role lasts.
        password: Encrypts the keys.
        by: Who does it.
        now_unix_s: When.

    Raises:
        KeysError: There are keys in the folder, or a threshold that no number of keys could meet.
        RepositoryFolderError: There is a repository.
    """
    repository = Repository(lab.repository_folder)
    for role in ROLES:
        if not 1 <= role_keys[role].threshold_count <= role_keys[role].keys_count:
            raise KeysError(
                f"{role}: {role_keys[role].threshold_count} of {role_keys[role].keys_count} keys cannot sign"
            )
    with repository.locked():
        if repository.newest_root_version() > 0:
            raise RepositoryFolderError(f"there is a repository in {repository.folder}")
        if any(keys_folder.glob("*.pem")) or (keys_folder / TRUSTED_ROOT_NAME).exists():
            raise KeysError(f"there are keys in {keys_folder}: choose an empty folder")
        root = Root(version=1, unrecognized_fields={PERIODS_FIELD: _checked_periods(periods)})
        root.expires = expiry(root, "root", now_unix_s=now_unix_s)
        made: list[tuple[NewKey, CryptoSigner]] = []
        for role in ROLES:
            for _ in range(role_keys[role].keys_count):
                path, signer = make_key(keys_folder, role, password=password)
                root.add_key(signer.public_key, role)
                made.append((NewKey(role, signer.public_key.keyid, path), signer))
            root.roles[role].threshold = role_keys[role].threshold_count
        first_root = _write_empty(repository, root, made, now_unix_s=now_unix_s)
        write_whole(keys_folder / TRUSTED_ROOT_NAME, first_root)
        keys = tuple(key for key, _ in made)
        _record(lab, root, ROLES, "repository begun", by=by, now_unix_s=now_unix_s)
    return keys


def rotate(
    lab: Laboratory,
    roles: Sequence[str],
    keys: SigningKeys,
    *,
    revoked: Iterable[str] = (),
    thresholds: Mapping[str, int] | None = None,
    new_key: bool = True,
    new_key_folder: Path | None = None,
    password: bytes | None = None,
    periods: Mapping[str, int] | None = None,
    by: str,
    reason: str,
    now_unix_s: float,
) -> tuple[Outcome, tuple[NewKey, ...]]:
    """Return what became of a new root with other keys, and the keys that were made for it.

    Several roles go in one step where both online keys are lost: one of them alone could not be published.

    Args:
        lab: Has the repository.
        roles: Which get a new key.
        keys: Those at hand; the new ones are written to the first folder.
        revoked: Key ids of these roles, or beginnings of them, that shall not count any more; "all" for every old one.
        thresholds: Other thresholds for some of the roles.
        new_key: Whether each role gets a new key; without, keys are only revoked and thresholds changed.
        new_key_folder: Where new keys go; the first folder of keys by default.
        password: Encrypts the new keys.
        periods: Other numbers of days for some roles' metadata.
        by: Who does it.
        reason: Why.
        now_unix_s: When.

    Raises:
        KeysError: The keys asked for do not fit; or so many are lost that no unit could follow.
        RepositoryFolderError: Another change waits for signatures, or the repository must not be built upon.
    """
    repository = Repository(lab.repository_folder)
    with repository.locked():
        refuse_second_change(repository)
        refuse_foreign_repository(repository, keys)
        keys.check(ROLES)
        base = repository.published()
        root = _next_root(base.root.signed, periods)
        gone = _revoked_ids(base.root.signed, roles, revoked)
        _refuse_dead_end(base.root.signed, gone, keys)
        for role in roles:
            for key_id in gone[role]:
                root.revoke_key(key_id, role)
            root.roles[role].threshold = (thresholds or {}).get(role, root.roles[role].threshold)
            if not 1 <= root.roles[role].threshold <= len(root.roles[role].keyids) + new_key:
                raise KeysError(
                    f"{role}: threshold {root.roles[role].threshold}, but {len(root.roles[role].keyids) + new_key} "
                    "keys would be left"
                )
        made: list[NewKey] = []
        for role in roles if new_key else ():
            path, signer = make_key(new_key_folder or keys.folders[0], role, password=password)
            root.add_key(signer.public_key, role)
            made.append(NewKey(role, signer.public_key.keyid, path))
        root.expires = expiry(root, "root", now_unix_s=now_unix_s)
        change = Change(
            what=f"root {root.version}: keys of {', '.join(roles)} ({reason})",
            root=Metadata(root),
            targets=None if _still_signed(root, base.targets) else _renewed_targets(base, root, now_unix_s=now_unix_s),
        )
        at_hand = keys if new_key_folder is None else _with_folder(keys, new_key_folder)
        _record(lab, root, roles, reason, by=by, now_unix_s=now_unix_s)
        return advance(repository, change, at_hand, now_unix_s=now_unix_s), tuple(made)


def renew(
    lab: Laboratory,
    keys: SigningKeys,
    *,
    periods: Mapping[str, int] | None = None,
    by: str,
    reason: str,
    now_unix_s: float,
) -> Outcome:
    """Return what became of a root and targets that say what they said, with later dates.

    Args:
        lab: Has the repository.
        keys: Those at hand.
        periods: Other numbers of days for some roles' metadata.
        by: Who does it.
        reason: Why.
        now_unix_s: When.

    Raises:
        KeysError: A key cannot be read.
        RepositoryFolderError: Another change waits for signatures, or the repository must not be built upon.
    """
    repository = Repository(lab.repository_folder)
    with repository.locked():
        refuse_second_change(repository)
        refuse_foreign_repository(repository, keys)
        keys.check(ROLES)
        base = repository.published()
        root = _next_root(base.root.signed, periods)
        root.expires = expiry(root, "root", now_unix_s=now_unix_s)
        change = Change(
            what=f"root {root.version}: later dates ({reason})",
            root=Metadata(root),
            targets=_renewed_targets(base, root, now_unix_s=now_unix_s),
        )
        _record(lab, root, ("root", "targets"), reason, by=by, now_unix_s=now_unix_s)
        return advance(repository, change, keys, now_unix_s=now_unix_s)


def _write_empty(
    repository: Repository, root: Root, made: Sequence[tuple[NewKey, CryptoSigner]], *, now_unix_s: float
) -> bytes:
    """Write a repository without targets and return its first root, which is written last: it makes the repository."""

    def signed(
        role: str, metadata: Metadata[Root] | Metadata[Targets] | Metadata[Snapshot] | Metadata[Timestamp]
    ) -> bytes:
        for key, signer in made:
            if key.role == role:
                metadata.sign(signer, append=True)
        return metadata.to_bytes()

    def expires(role: str) -> datetime:
        return expiry(root, role, now_unix_s=now_unix_s)

    targets = signed("targets", Metadata(Targets(version=1, expires=expires("targets"))))
    snapshot = signed(
        "snapshot",
        Metadata(
            Snapshot(
                version=1,
                expires=expires("snapshot"),
                meta={"targets.json": MetaFile.from_data(1, targets, ["sha256"])},
            )
        ),
    )
    timestamp = signed(
        "timestamp",
        Metadata(
            Timestamp(
                version=1,
                expires=expires("timestamp"),
                snapshot_meta=MetaFile.from_data(1, snapshot, ["sha256"]),
            )
        ),
    )
    content = signed("root", Metadata(root))
    repository.targets_folder.mkdir(parents=True, exist_ok=True)
    for name, written in (("1.targets", targets), ("1.snapshot", snapshot), ("timestamp", timestamp)):
        write_whole(repository.metadata_folder / f"{name}.json", written)
    write_whole(repository.trusted_root_path, content)
    write_whole(repository.root_path(1), content)
    return content


def _next_root(before: Root, periods: Mapping[str, int] | None) -> Root:
    root = copy.deepcopy(before)
    root.version += 1
    root.unrecognized_fields[PERIODS_FIELD] = _checked_periods(
        {**root.unrecognized_fields[PERIODS_FIELD], **(periods or {})}
    )
    return root


def _checked_periods(periods: Mapping[str, int]) -> dict[str, int]:
    for role in ROLES:
        if periods[role] < 1:
            raise KeysError(f"{role}: metadata that lasts {periods[role]} days is expired when it is signed")
    return {role: int(periods[role]) for role in ROLES}


def _renewed_targets(base: Published, root: Root, *, now_unix_s: float) -> Metadata[Targets]:
    targets = copy.deepcopy(base.targets.signed)
    targets.version += 1
    targets.expires = expiry(root, "targets", now_unix_s=now_unix_s)
    return Metadata(targets)


def _still_signed(root: Root, targets: Metadata[Targets]) -> bool:
    return bool(root.get_verification_result("targets", targets.signed_bytes, targets.signatures))


def _revoked_ids(root: Root, roles: Sequence[str], named: Iterable[str]) -> dict[str, list[str]]:
    wanted = list(named)
    gone: dict[str, list[str]] = {}
    known = [key_id for role in roles for key_id in root.roles[role].keyids]
    for beginning in wanted:
        if beginning != ALL_KEYS and len([key_id for key_id in known if key_id.startswith(beginning)]) != 1:
            raise KeysError(
                f"{beginning!r} is not the beginning of exactly one key of {', '.join(roles)}; "
                f"they are {', '.join(key_id[:SHORT_ID_CHARS] for key_id in known)}"
            )
    for role in roles:
        gone[role] = [
            key_id
            for key_id in root.roles[role].keyids
            if ALL_KEYS in wanted or any(key_id.startswith(beginning) for beginning in wanted)
        ]
    return gone


def _refuse_dead_end(root: Root, gone: Mapping[str, Sequence[str]], keys: SigningKeys) -> None:
    """Refuse to begin what nobody could finish: units follow only a root that enough of their root's keys have signed.

    Keys that are to be revoked and are not at hand count as lost.
    """
    at_hand = keys.of_role("root")
    left = [key_id for key_id in root.roles["root"].keyids if key_id in at_hand or key_id not in gone.get("root", ())]
    threshold = root.roles["root"].threshold
    if len(left) < threshold:
        raise KeysError(
            f"{threshold} of the present root keys must sign for units to follow, and only {len(left)} are left: "
            "units need a new trusted root by hand. Make a new repository with `roadgrip-train keys init`, and carry "
            f"its {TRUSTED_ROOT_NAME} to every unit"
        )


def _with_folder(keys: SigningKeys, folder: Path) -> SigningKeys:
    return SigningKeys((*keys.folders, folder), keys.passwords)


def _record(lab: Laboratory, root: Root, roles: Sequence[str], reason: str, *, by: str, now_unix_s: float) -> None:
    lab.record(
        Action.KEYS_CHANGED,
        ", ".join(roles),
        reason=reason,
        evidence={
            "root_version": str(root.version),
            **{f"keys.{role}": " ".join(root.roles[role].keyids) for role in ROLES},
            **{f"threshold.{role}": str(root.roles[role].threshold) for role in ROLES},
            **{f"days.{role}": str(root.unrecognized_fields[PERIODS_FIELD][role]) for role in ROLES},
        },
        actor=by,
        now_unix_s=now_unix_s,
    )
