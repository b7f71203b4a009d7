"""A bundle becomes the release of a ring: written in the ledger, signed, published; old bundles go."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from tuf.api.metadata import Metadata, Targets

from roadgrip.bundle import MANIFEST_NAME, BundleManifest, check_files
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError
from roadgrip.ledger import TEXT_LIMIT_CHARS, Action, LedgerEntry
from roadgrip.release import Release, bundle_target, release_to_json, ring_target
from training.laboratory import Laboratory
from training.promotion.change import (
    Change,
    Outcome,
    advance,
    refuse_foreign_repository,
    refuse_second_change,
    staged_change,
    withdraw,
)
from training.promotion.decision import (
    PromotionError,
    gate_of,
    promotion_problem,
    published_promotions,
    rings_of,
    standing_of,
)
from training.promotion.keys import ONLINE_ROLES, SigningKeys
from training.promotion.repository import Published, Repository, RepositoryFolderError, bundle_ids, expiry

DEFAULT_KEPT_COUNT = 5


@dataclass(frozen=True, slots=True)
class BundleFiles:
    """A bundle whose files are the ones its manifest names.

    Attributes:
        manifest: What it says of itself.
        files: Every file, the manifest among them.
    """

    manifest: BundleManifest
    files: Mapping[str, bytes]

    @property
    def files_sha256(self) -> dict[str, str]:
        """The digest of every file."""
        return {name: hashlib.sha256(content).hexdigest() for name, content in sorted(self.files.items())}


@dataclass(frozen=True, slots=True)
class VerdictOnBundle:
    """What the gate said of a bundle.

    Attributes:
        digest: Of the verdict.
        challenger_id: The bundle.
        champion_id: What it was held against.
        passed: Whether it may be promoted.
    """

    digest: str
    challenger_id: str
    champion_id: str | None
    passed: bool


def checked_bundle(files: Mapping[str, bytes], *, where: str) -> BundleFiles:
    """Return a bundle after holding its files against its manifest.

    Raises:
        BundleError: They differ, or there is no manifest.
        FeatureTableError: A model was made for a feature table that this software does not speak.
    """
    if MANIFEST_NAME not in files:
        raise BundleError(f"no bundle in {where}: it has no {MANIFEST_NAME}")
    manifest = manifest_from_json(files[MANIFEST_NAME].decode())
    check_files(manifest, {name: content for name, content in files.items() if name != MANIFEST_NAME})
    return BundleFiles(manifest, files)


def read_bundle(folder: Path) -> BundleFiles:
    """Return the bundle in a folder.

    Raises:
        BundleError: There is none, or its files are not those of its manifest.
    """
    paths = sorted(folder.iterdir()) if folder.is_dir() else []
    return checked_bundle({path.name: path.read_bytes() for path in paths if path.is_file()}, where=str(folder))


def publish_release(
    lab: Laboratory,
    signers: SigningKeys,
    *,
    bundle_folder: Path,
    ring: str,
    gate: str,
    verdict_digest: str | None,
    reason: str,
    by: str,
    now_unix_s: float,
    override_reason: str | None = None,
) -> Release:
    """Return the release of a bundle to a ring, whoever decided it.

    If signatures are missing it waits in staged/, see `training.promotion.change.staged_change`.

    Args:
        lab: Has the repository.
        signers: The keys at hand.
        bundle_folder: The bundle.
        ring: Who gets it.
        gate: "passed", "overridden" or "none", see `roadgrip.release.Release`.
        verdict_digest: Of the gate's verdict; None without one.
        reason: Why.
        by: Who decided.
        now_unix_s: When.
        override_reason: Why in spite of the gate or the order of rings.

    Raises:
        BundleError: The bundle is none.
        ReleaseError: The ring or the gate's word is none.
        KeysError: A key cannot be read.
        RepositoryFolderError: Another change waits for signatures, or the repository must not be built upon.
    """
    bundle = read_bundle(bundle_folder)
    repository = Repository(lab.repository_folder)
    with repository.locked():
        base = _ready(repository, signers)
        release, _ = _publish(
            lab,
            repository,
            base,
            signers,
            bundle,
            ring=ring,
            gate=gate,
            verdict_digest=verdict_digest,
            reason=reason,
            override_reason=override_reason,
            by=by,
            now_unix_s=now_unix_s,
        )
    return release


def promote(
    lab: Laboratory,
    signers: SigningKeys,
    *,
    bundle: BundleFiles,
    ring: str,
    verdicts: Mapping[str | None, VerdictOnBundle],
    reason: str,
    override_reason: str | None,
    by: str,
    now_unix_s: float,
) -> tuple[Release, Outcome]:
    """Return the release of a bundle to a ring and what became of it, if nothing speaks against it.

    What speaks against it is asked with the lock held: the champion is the one that it would follow.

    Args:
        lab: Has the repository.
        signers: The keys at hand.
        bundle: To promote.
        ring: Who gets it.
        verdicts: What the gate said of this bundle, by the champion it was held against.
        reason: Why.
        override_reason: Why in spite of everything that may speak against it.
        by: Who decides.
        now_unix_s: When.

    Raises:
        PromotionError: Something speaks against it, and it is not overridden.
        KeysError: A key cannot be read.
        RepositoryFolderError: Another change waits for signatures, or the repository must not be built upon.
    """
    repository, rings = Repository(lab.repository_folder), rings_of(lab)
    bundle_id = bundle.manifest.bundle_id
    if override_reason is not None and not override_reason.strip():
        raise PromotionError("an override needs a reason")
    with repository.locked():
        base = _ready(repository, signers)
        releases = repository.releases(base.targets.signed)
        champion = releases.get(rings[-1])
        verdict = verdicts.get(None if champion is None else champion.bundle_id)
        if verdict is not None and verdict.challenger_id != bundle_id:
            raise PromotionError(f"the verdict is about bundle {verdict.challenger_id}, not about {bundle_id}")
        standing = standing_of(
            bundle_id,
            rings=rings,
            releases=releases,
            ledger=lab.ledger(),
            verdict_passed=None if verdict is None else verdict.passed,
        )
        overridden = override_reason is not None
        problem = promotion_problem(bundle_id, ring, rings=rings, standing=standing, overridden=overridden)
        gate = gate_of(bundle_id, standing=standing, overridden=overridden)
        if problem is not None or gate is None:
            raise PromotionError(problem or f"bundle {bundle_id} is not promoted")
        return _publish(
            lab,
            repository,
            base,
            signers,
            bundle,
            ring=ring,
            gate=gate,
            verdict_digest=None if verdict is None else verdict.digest,
            reason=reason,
            override_reason=override_reason,
            by=by,
            now_unix_s=now_unix_s,
        )


def withdraw_change(lab: Laboratory, *, reason: str, by: str, now_unix_s: float) -> str:
    """Return what was withdrawn before it was published; the ledger says so too.

    Raises:
        RepositoryFolderError: Nothing waits for signatures, or units may have seen a part of it.
    """
    repository = Repository(lab.repository_folder)
    with repository.locked():
        change = withdraw(repository)
        what = "a damaged change" if change is None else change.what
        release = None if change is None else change.release
        lab.record(
            Action.REFUSED,
            what if release is None else release.bundle_id,
            reason=reason,
            evidence={"what": what, **({} if release is None else {"withdrawn": release.ledger_hash})},
            actor=by,
            now_unix_s=now_unix_s,
        )
    return what


def prune(
    lab: Laboratory, signers: SigningKeys, *, kept_count: int = DEFAULT_KEPT_COUNT, now_unix_s: float
) -> tuple[Outcome | None, tuple[str, ...]]:
    """Return what became of the repository without its oldest bundles, and their ids; None if there was nothing to do.

    Bundles that a ring runs stay, and of the others the ones that were promoted last, to step back to.

    Args:
        lab: Has the repository.
        signers: The keys at hand.
        kept_count: Bundles that stay although no ring runs them.
        now_unix_s: When.
    """
    repository = Repository(lab.repository_folder)
    with repository.locked():
        base = _ready(repository, signers)
        targets = copy.deepcopy(base.targets.signed)
        running = {release.bundle_id for release in repository.releases(targets).values()}
        last_promoted = {entry.subject: number for number, entry in enumerate(published_promotions(lab.ledger()))}
        idle = sorted(set(bundle_ids(targets)) - running, key=lambda each: last_promoted.get(each, -1), reverse=True)
        gone = tuple(idle[kept_count:])
        if not gone:
            if staged_change(repository) is None:
                for path in repository.surplus_files(targets):
                    path.unlink()
            return None, ()
        for bundle_id in gone:
            prefix = bundle_target(bundle_id, "")
            for name in [name for name in targets.targets if name.startswith(prefix)]:
                del targets.targets[name]
        targets.version += 1
        targets.expires = expiry(base.root.signed, "targets", now_unix_s=now_unix_s)
        change = Change(what=f"without {', '.join(gone)}", targets=Metadata(targets), tidies=True)
        return advance(repository, change, signers, now_unix_s=now_unix_s), gone


def ledger_problems(lab: Laboratory, entries: list[LedgerEntry]) -> list[str]:
    """Return what does not fit between the repository's releases and the ledger, a line each.

    Raises:
        RepositoryFolderError: The repository must not be trusted.
        ReleaseError: A pointer in it is no release.
    """
    repository = Repository(lab.repository_folder)
    if repository.newest_root_version() < 1:
        return []
    by_hash = {entry.entry_hash: entry for entry in entries}
    problems = []
    for ring, release in repository.releases(repository.published().targets.signed).items():
        entry = by_hash.get(release.ledger_hash)
        if entry is None:
            problems.append(
                f"ring {ring}: release {release.sequence_number} names the entry {release.ledger_hash[:16]}, "
                "which is not in the ledger"
            )
        elif (entry.action, entry.subject, entry.evidence.get("ring"), entry.evidence.get("sequence_number")) != (
            Action.PROMOTED,
            release.bundle_id,
            release.ring,
            str(release.sequence_number),
        ):
            problems.append(
                f"ring {ring}: release {release.sequence_number} names entry {entry.sequence_number}, "
                "which is about something else"
            )
    return problems


def _ready(repository: Repository, signers: SigningKeys) -> Published:
    """Return what is published, if a change of targets can be made upon it with the keys at hand."""
    refuse_second_change(repository)
    refuse_foreign_repository(repository, signers)
    signers.check(("targets", *ONLINE_ROLES))
    return repository.published()


def _publish(
    lab: Laboratory,
    repository: Repository,
    base: Published,
    signers: SigningKeys,
    bundle: BundleFiles,
    *,
    ring: str,
    gate: str,
    verdict_digest: str | None,
    reason: str,
    override_reason: str | None,
    by: str,
    now_unix_s: float,
) -> tuple[Release, Outcome]:
    bundle_id, files_sha256 = bundle.manifest.bundle_id, bundle.files_sha256
    _refuse_other_files(repository, base.targets.signed, bundle)
    draft = Release(
        ring=ring,
        sequence_number=_next_sequence_number(repository, base.targets.signed, lab.ledger()),
        bundle_id=bundle_id,
        files_sha256=files_sha256,
        released_unix_s=int(now_unix_s),
        released_by=by,
        reason=reason[:TEXT_LIMIT_CHARS],
        gate=gate,
        ledger_hash="",
    )
    entry = lab.record(
        Action.PROMOTED,
        bundle_id,
        reason=reason,
        evidence=_evidence(draft, verdict_digest=verdict_digest, override_reason=override_reason),
        actor=by,
        now_unix_s=now_unix_s,
    )
    release = replace(draft, ledger_hash=entry.entry_hash)
    targets = copy.deepcopy(base.targets.signed)
    contents = {bundle_target(bundle_id, name): content for name, content in bundle.files.items()}
    contents[ring_target(ring)] = release_to_json(release).encode()
    for path, content in contents.items():
        targets.targets[path] = repository.add_target(path, content)
    targets.version += 1
    targets.expires = expiry(base.root.signed, "targets", now_unix_s=now_unix_s)
    what = f"release {release.sequence_number}: bundle {bundle_id} to ring {ring}"
    change = Change(what=what, targets=Metadata(targets), release=release)
    return release, advance(repository, change, signers, now_unix_s=now_unix_s)


def _refuse_other_files(repository: Repository, targets: Targets, bundle: BundleFiles) -> None:
    # An id speaks for the models alone; two manifests with other figures may share it, and a pointer to the first one
    # would not fit any more.
    held = repository.bundle_files(targets, bundle.manifest.bundle_id)
    if held is not None and held != dict(bundle.files):
        differing = sorted(name for name in {*held, *bundle.files} if held.get(name) != bundle.files.get(name))
        raise RepositoryFolderError(
            f"the repository holds bundle {bundle.manifest.bundle_id} with another {', '.join(differing)}: promote it "
            "from there, by its id"
        )


def _next_sequence_number(repository: Repository, targets: Targets, ledger: list[LedgerEntry]) -> int:
    # The ledger knows also of releases that were withdrawn, and of those before a repository was begun again.
    told = [entry.evidence.get("sequence_number", "") for entry in ledger if entry.action is Action.PROMOTED]
    released = [release.sequence_number for release in repository.releases(targets).values()]
    return max([*released, *(int(number) for number in told if number.isdigit())], default=0) + 1


def _evidence(release: Release, *, verdict_digest: str | None, override_reason: str | None) -> dict[str, str]:
    text = json.dumps(dict(release.files_sha256), sort_keys=True, separators=(",", ":"))
    evidence = {
        "ring": release.ring,
        "sequence_number": str(release.sequence_number),
        "gate": release.gate,
        "files_sha256": hashlib.sha256(text.encode()).hexdigest(),
    }
    if verdict_digest is not None:
        evidence["verdict"] = verdict_digest
    if override_reason is not None:
        evidence["override"] = override_reason
    return evidence
