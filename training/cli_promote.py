"""`roadgrip-train promote`, `sign`, `refresh` and `repository`: what units shall run, signed."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.errors import BundleError
from roadgrip.release import Release
from training.cli_designs import AsJson, console
from training.laboratory import DEFAULT_FOLDER, LAB_VARIABLE, Laboratory, account
from training.retraining.registry import ADDRESS_VARIABLE, CANARY, CHALLENGER, CHAMPION, models, registered, set_alias
from training.tracking import DATABASE_FILE_NAME

# Signing and the register of models take a while to import: they are where they are needed.
if TYPE_CHECKING:
    from training.promotion.change import Outcome
    from training.promotion.keys import SigningKeys
    from training.promotion.publication import BundleFiles

SHORT_ID_CHARS = 12

LabFolder = Annotated[
    Path, typer.Option("--lab", metavar="FOLDER", envvar=LAB_VARIABLE, help="Folder of the laboratory.")
]
KeysFolders = Annotated[
    list[Path], typer.Option("--keys", metavar="FOLDER", help="Folder of keys; again for another holder's.")
]
PasswordFiles = Annotated[
    list[Path] | None,
    typer.Option("--password-file", metavar="FILE", help="Its first line opens encrypted keys; again for others."),
]
By = Annotated[str | None, typer.Option("--by", metavar="NAME", help="Who does it.", show_default="your account")]
RepositoryFolder = Annotated[
    Path | None,
    typer.Option("--repository", metavar="FOLDER", help="The repository itself, such as a copy on a stick."),
]

repository_app = typer.Typer(
    name="repository",
    help="Look at the signed repository, verify it as a unit would, and drop old bundles.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


def promote(
    *,
    ring: Annotated[str, typer.Option("--ring", metavar="RING", help="Who gets it, such as canary, then all.")],
    keys: KeysFolders,
    lab: LabFolder = DEFAULT_FOLDER,
    model: Annotated[
        str,
        typer.Option(
            "--model",
            metavar="REF",
            help="An alias or version of the register, a bundle's id in the repository, or a bundle's folder.",
        ),
    ] = CHALLENGER,
    override: Annotated[
        str | None,
        typer.Option("--override", metavar="REASON", help="Do it without a passed gate; the reason is recorded."),
    ] = None,
    reason: Annotated[str | None, typer.Option("--reason", metavar="TEXT", help="Why, for the ledger.")] = None,
    by: By = None,
    password_file: PasswordFiles = None,
    as_json: AsJson = False,
) -> None:
    """Release a bundle to a ring of units: write it in the ledger, sign it, publish it, and move the alias.

    Example: roadgrip-train promote --ring canary --keys /media/stick/keys --keys keys-online
    """
    from training.promotion.publication import promote as promoted
    from training.promotion.verdicts import verdicts_on

    laboratory = Laboratory(lab)
    bundle = _bundle(laboratory, model)
    release, outcome = promoted(
        laboratory,
        signing_keys(keys, password_file),
        bundle=bundle,
        ring=ring,
        verdicts=verdicts_on(laboratory, bundle.manifest.bundle_id),
        reason=reason or override or f"to ring {ring}",
        override_reason=override,
        by=by or account(),
        now_unix_s=time.time(),
    )
    print_outcome(outcome, as_json=as_json, aliases=_moved_aliases(laboratory, outcome), release=release)


def sign(
    *,
    keys: Annotated[
        list[Path] | None, typer.Option("--keys", metavar="FOLDER", help="Folder of keys; without, only look.")
    ] = None,
    lab: LabFolder = DEFAULT_FOLDER,
    repository: RepositoryFolder = None,
    withdraw: Annotated[
        str | None, typer.Option("--withdraw", metavar="REASON", help="Drop the change instead; this is recorded.")
    ] = None,
    by: By = None,
    password_file: PasswordFiles = None,
    as_json: AsJson = False,
) -> None:
    """Add signatures to the change that waits for them, and publish it once none is missing.

    Example: roadgrip-train sign --keys /media/other-stick/keys
    """
    from training.promotion import change, publication
    from training.promotion.repository import Repository

    laboratory = Laboratory(lab)
    if withdraw is not None:
        what = publication.withdraw_change(laboratory, reason=withdraw, by=by or account(), now_unix_s=time.time())
        typer.echo(json.dumps({"withdrawn": what}) if as_json else f"withdrawn: {what}")
        return
    folder = Repository(repository or laboratory.repository_folder)
    if not keys:
        waiting = change.staged_change(folder)
        lines = [] if waiting is None else change.differences(folder, waiting)
        typer.echo(json.dumps(lines) if as_json else "\n".join(lines) or "no change waits for signatures")
        return
    lines, outcome = change.sign(folder, signing_keys(keys, password_file), now_unix_s=time.time())
    if not as_json:
        typer.echo("".join(f"signed: {line}\n" for line in lines), nl=False)
    print_outcome(
        outcome,
        as_json=as_json,
        aliases=[] if repository else _moved_aliases(laboratory, outcome),
        release=outcome.release,
    )


def refresh(
    *,
    keys: KeysFolders,
    lab: LabFolder = DEFAULT_FOLDER,
    password_file: PasswordFiles = None,
    as_json: AsJson = False,
) -> None:
    """Sign snapshot and timestamp anew with the online keys, for another while; give it to cron.

    A change that waits for nothing but these two is published.

    Example: roadgrip-train refresh --keys keys-online
    """
    from training.promotion import change
    from training.promotion.overview import day, overview
    from training.promotion.repository import Repository

    laboratory, now_unix_s = Laboratory(lab), time.time()
    repository = Repository(laboratory.repository_folder)
    outcome = change.refresh(repository, signing_keys(keys, password_file), now_unix_s=now_unix_s)
    print_outcome(outcome, as_json=as_json, aliases=_moved_aliases(laboratory, outcome), release=outcome.release)
    for role in overview(repository).roles:
        if role.state(now_unix_s=now_unix_s) != "good":
            end = f"{role.role} ends on {day(role.expires_unix_s)}: `roadgrip-train keys renew`, or promote a bundle"
            console.print(f"warning: {end}", highlight=False, soft_wrap=True, style="yellow")


@repository_app.command(name="show")
def repository_show(
    *, lab: LabFolder = DEFAULT_FOLDER, repository: RepositoryFolder = None, as_json: AsJson = False
) -> None:
    """List rings, bundles, versions with their dates, keys and thresholds.

    Example: roadgrip-train repository show
    """
    from training.promotion.overview import day, overview
    from training.promotion.repository import Repository

    now_unix_s = time.time()
    held = overview(Repository(repository or Laboratory(lab).repository_folder))
    if as_json:
        states = {role.role: role.state(now_unix_s=now_unix_s) for role in held.roles}
        typer.echo(json.dumps({**asdict(held), "states": states}))
        return
    rings = Table("ring", "release", "bundle", "of", "by", "gate", "reason")
    for ring, release in held.releases.items():
        what = (str(release.sequence_number), release.bundle_id, day(release.released_unix_s), release.released_by)
        rings.add_row(ring, *what, release.gate, release.reason)
    roles = Table("role", "version", "good until", "signs", "keys")
    for role in held.roles:
        roles.add_row(
            role.role,
            str(role.version),
            f"{day(role.expires_unix_s)} ({role.state(now_unix_s=now_unix_s)})",
            f"{role.threshold_count} of {len(role.key_ids)}",
            " ".join(key_id[:SHORT_ID_CHARS] for key_id in role.key_ids),
        )
    out = Console()
    out.print(rings)
    out.print(roles)
    typer.echo(f"bundles: {' '.join(held.bundle_ids) or 'none'}")
    if held.waiting is not None:
        typer.echo(f"waits for signatures: {held.waiting}")


@repository_app.command(name="verify")
def repository_verify(
    *,
    trusted_root: Annotated[
        Path, typer.Option("--trusted-root", metavar="FILE", help="What units were given, from elsewhere than here.")
    ],
    lab: LabFolder = DEFAULT_FOLDER,
    repository: RepositoryFolder = None,
    as_json: AsJson = False,
) -> None:
    """Read the repository as a unit would, and say what the units of each ring would get; exit code 1 with problems.

    Example: roadgrip-train repository verify --trusted-root trusted-root.json --repository /media/stick/repository
    """
    from training.promotion.decision import rings_of
    from training.promotion.repository import Repository
    from training.promotion.verification import verify

    laboratory = Laboratory(lab)
    found = verify(
        Repository(repository or laboratory.repository_folder), trusted_root.read_bytes(), now_unix_s=time.time()
    )
    if as_json:
        typer.echo(json.dumps(asdict(found)))
    else:
        rings = dict.fromkeys([*(rings_of(laboratory) if repository is None else ()), *found.releases])
        for ring in rings:
            release = found.releases.get(ring)
            typer.echo(
                f"ring {ring}: nothing"
                if release is None
                else f"ring {ring}: bundle {release.bundle_id}, release {release.sequence_number}, gate {release.gate}"
            )
        typer.echo(
            "".join(f"{problem}\n" for problem in found.problems) or "everything is as it was signed\n", nl=False
        )
    if found.problems:
        raise typer.Exit(1)


@repository_app.command(name="prune")
def repository_prune(
    *,
    keys: KeysFolders,
    lab: LabFolder = DEFAULT_FOLDER,
    keep: Annotated[int, typer.Option("--keep", min=0, help="Bundles to step back to, besides those that run.")] = 5,
    password_file: PasswordFiles = None,
    as_json: AsJson = False,
) -> None:
    """Drop the oldest bundles that no ring runs, and files that nothing is signed about any more.

    Example: roadgrip-train repository prune --keep 5 --keys /media/stick/keys --keys keys-online
    """
    from training.promotion.publication import prune

    outcome, gone = prune(Laboratory(lab), signing_keys(keys, password_file), kept_count=keep, now_unix_s=time.time())
    if outcome is None:
        typer.echo(json.dumps({"removed": []}) if as_json else "no bundle is older than those that are kept")
        return
    print_outcome(outcome, as_json=as_json, extra={"removed": list(gone)})


def signing_keys(folders: Sequence[Path], password_files: Sequence[Path] | None) -> SigningKeys:
    """Return the keys in some folders, with what opens them."""
    from training.promotion.keys import SigningKeys, read_password

    return SigningKeys(tuple(folders), tuple(read_password(path) for path in password_files or ()))


def print_outcome(
    outcome: Outcome,
    *,
    as_json: bool,
    aliases: Sequence[str] = (),
    release: Release | None = None,
    extra: dict[str, object] | None = None,
) -> None:
    """Print what became of a change; signatures that are missing are no error, since others hold those keys."""
    if as_json:
        said = {"what": outcome.what, "published": outcome.published, "missing": list(outcome.missing)}
        typer.echo(
            json.dumps({**said, "aliases": list(aliases), "release": release and asdict(release), **(extra or {})})
        )
        return
    if outcome.published:
        typer.echo(f"published: {outcome.what}" + "".join(f"; alias {alias} moved" for alias in aliases))
        return
    typer.echo(f"not published yet: {outcome.what}")
    typer.echo("".join(f"  missing: {line}\n" for line in outcome.missing), nl=False)
    typer.echo("`roadgrip-train sign --keys OTHER` goes on; keys that are lost: docs/releases.md")


def _bundle(lab: Laboratory, model: str) -> BundleFiles:
    """Return the bundle that somebody means: a folder, an id in the repository, or a name of the register."""
    from training.promotion.publication import checked_bundle, read_bundle
    from training.promotion.repository import Repository

    if (Path(model) / MANIFEST_NAME).is_file():
        return read_bundle(Path(model))
    repository = Repository(lab.repository_folder)
    files = repository.bundle_files(repository.published().targets.signed, model)
    if files is not None:
        return checked_bundle(files, where=str(repository.folder))
    if not _has_register(lab):
        raise BundleError(
            f"no bundle {model!r}: it is no folder, the repository does not hold it, and {lab.folder} has no register"
        )
    return read_bundle(registered(lab, model).folder)


def _moved_aliases(lab: Laboratory, outcome: Outcome) -> list[str]:
    """Return the aliases that were moved to the release that is published now."""
    from training.promotion.decision import rings_of

    release = outcome.release
    if release is None or not outcome.published:
        return []
    rings = rings_of(lab)
    ends = ((rings[0], CANARY), (rings[-1], CHAMPION))
    aliases = [alias for ring, alias in ends if ring == release.ring]
    if not aliases or not _has_register(lab):
        return []
    version = next((model.version for model in models(lab) if model.bundle_id == release.bundle_id), None)
    if version is None:  # a bundle from a folder: released all the same
        console.print(f"no alias is moved: bundle {release.bundle_id} is not in the register", highlight=False)
        return []
    for alias in aliases:
        set_alias(lab, alias, version)
    return aliases


def _has_register(lab: Laboratory) -> bool:
    # Asking an empty laboratory would make it one, which takes seconds.
    return bool(os.environ.get(ADDRESS_VARIABLE)) or (lab.folder / DATABASE_FILE_NAME).is_file()
