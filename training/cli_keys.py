"""`roadgrip-train keys`: who may sign what units trust."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from training.cli_designs import AsJson
from training.cli_promote import By, KeysFolders, LabFolder, PasswordFiles, print_outcome, signing_keys
from training.laboratory import DEFAULT_FOLDER, Laboratory, account

# Signing takes a while to import: it is where it is needed.
if TYPE_CHECKING:
    from training.promotion.ceremony import NewKey

keys_app = typer.Typer(
    name="keys",
    help="Make, change and list the keys that sign what units trust.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Days = Annotated[int | None, typer.Option(min=1, metavar="DAYS", help="How long its metadata lasts from now on.")]
PasswordFile = Annotated[
    Path | None, typer.Option("--password-file", metavar="FILE", help="Its first line encrypts the keys.")
]
Count = Annotated[int, typer.Option(min=1, metavar="N")]


@keys_app.command()
def init(
    *,
    keys: Annotated[Path, typer.Option("--keys", metavar="FOLDER", help="Where the keys go; an empty or new folder.")],
    lab: LabFolder = DEFAULT_FOLDER,
    root_keys: Count = 2,
    root_threshold: Count = 1,
    targets_keys: Count = 1,
    targets_threshold: Count = 1,
    root_days: Count = 365,
    targets_days: Count = 365,
    snapshot_days: Count = 45,
    timestamp_days: Count = 45,
    password_file: PasswordFile = None,
    by: By = None,
    as_json: AsJson = False,
) -> None:
    """Make keys and an empty signed repository, and say where each of them belongs.

    Example: roadgrip-train keys init --keys keys --root-keys 3 --root-threshold 2
    """
    from training.promotion.ceremony import RoleKeys, begin_repository
    from training.promotion.keys import read_password
    from training.promotion.repository import Repository

    laboratory = Laboratory(lab)
    made = begin_repository(
        laboratory,
        keys,
        role_keys={
            "root": RoleKeys(root_keys, root_threshold),
            "targets": RoleKeys(targets_keys, targets_threshold),
            "snapshot": RoleKeys(),
            "timestamp": RoleKeys(),
        },
        periods={"root": root_days, "targets": targets_days, "snapshot": snapshot_days, "timestamp": timestamp_days},
        password=None if password_file is None else read_password(password_file),
        by=by or account(),
        now_unix_s=time.time(),
    )
    if as_json:
        typer.echo(json.dumps(_keys_json(made)))
        return
    _print_new(made)
    typer.echo(f"units: {Repository(laboratory.repository_folder).trusted_root_path} goes to each by a way you trust")


@keys_app.command()
def rotate(
    roles: Annotated[list[str], typer.Argument(metavar="ROLE...", help="root, targets, snapshot, timestamp.")],
    *,
    keys: KeysFolders,
    lab: LabFolder = DEFAULT_FOLDER,
    revoke: Annotated[
        list[str] | None,
        typer.Option("--revoke", metavar="KEYID", help="Beginning of a key's id, or all; again for others."),
    ] = None,
    threshold: Annotated[
        int | None, typer.Option("--threshold", min=1, metavar="N", help="How many keys of these roles must sign.")
    ] = None,
    no_new_key: Annotated[bool, typer.Option("--no-new-key", help="Only revoke, or change the threshold.")] = False,
    into: Annotated[
        Path | None,
        typer.Option("--into", metavar="FOLDER", help="Where new keys go.", show_default="the first --keys"),
    ] = None,
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="Why, for the ledger.")] = "rotation",
    by: By = None,
    password_file: PasswordFiles = None,
    as_json: AsJson = False,
) -> None:
    """Give roles a new key, and take away those that are named; the root's keys before and after sign that.

    With a password file the new keys are encrypted with the first password.

    Example: roadgrip-train keys rotate timestamp --revoke all --keys /media/stick/keys --keys keys-online
    """
    from training.promotion import ceremony
    from training.promotion.keys import ROLES

    for role in roles:
        if role not in ROLES:
            raise typer.BadParameter(f"{role!r} is none of {', '.join(ROLES)}", param_hint="ROLE")
    signing = signing_keys(keys, password_file)
    outcome, made = ceremony.rotate(
        Laboratory(lab),
        tuple(dict.fromkeys(roles)),
        signing,
        revoked=revoke or (),
        thresholds={} if threshold is None else dict.fromkeys(roles, threshold),
        new_key=not no_new_key,
        new_key_folder=into,
        password=signing.passwords[0] if signing.passwords else None,
        by=by or account(),
        reason=reason,
        now_unix_s=time.time(),
    )
    print_outcome(outcome, as_json=as_json, extra={"keys": _keys_json(made)})
    if not as_json:
        _print_new(made)
        if made and not revoke:
            typer.echo("the keys before stay valid; --revoke takes them away")


@keys_app.command()
def renew(
    *,
    keys: KeysFolders,
    lab: LabFolder = DEFAULT_FOLDER,
    root_days: Days = None,
    targets_days: Days = None,
    snapshot_days: Days = None,
    timestamp_days: Days = None,
    reason: Annotated[str, typer.Option("--reason", metavar="TEXT", help="Why, for the ledger.")] = "later dates",
    by: By = None,
    password_file: PasswordFiles = None,
    as_json: AsJson = False,
) -> None:
    """Sign root and targets anew with later dates, before they expire; nothing else in them changes.

    How long each role's metadata lasts stands in the root: this is where to change it.

    Example: roadgrip-train keys renew --snapshot-days 7 --timestamp-days 7 --keys /media/stick/keys --keys keys-online
    """
    from training.promotion import ceremony

    days = {"root": root_days, "targets": targets_days, "snapshot": snapshot_days, "timestamp": timestamp_days}
    outcome = ceremony.renew(
        Laboratory(lab),
        signing_keys(keys, password_file),
        periods={role: count for role, count in days.items() if count is not None},
        by=by or account(),
        reason=reason,
        now_unix_s=time.time(),
    )
    print_outcome(outcome, as_json=as_json)


@keys_app.command()
def show(
    *,
    keys: Annotated[
        list[Path] | None, typer.Option("--keys", metavar="FOLDER", help="Say also which key file is which.")
    ] = None,
    lab: LabFolder = DEFAULT_FOLDER,
    password_file: PasswordFiles = None,
    as_json: AsJson = False,
) -> None:
    """List the keys that the newest root names, and the files of those at hand.

    Example: roadgrip-train keys show --keys keys
    """
    from training.promotion.keys import ROLES
    from training.promotion.repository import Repository

    root = Repository(Laboratory(lab).repository_folder).roots()[-1].signed
    at_hand = signing_keys(keys or (), password_file)
    files = {role: at_hand.files_of_role(role) for role in ROLES}
    rows = [
        {
            "role": role,
            "key_id": key_id,
            "valid": key_id in root.roles[role].keyids,
            "file": str(files[role][key_id]) if key_id in files[role] else None,
        }
        for role in ROLES
        for key_id in dict.fromkeys([*root.roles[role].keyids, *files[role]])
    ]
    if as_json:
        thresholds = {role: root.roles[role].threshold for role in ROLES}
        typer.echo(json.dumps({"root_version": root.version, "thresholds": thresholds, "keys": rows}))
        return
    for role in ROLES:
        typer.echo(f"{role}: {root.roles[role].threshold} of {len(root.roles[role].keyids)} must sign")
        for row in rows:
            if row["role"] == role:
                place = f" {row['file']}" if row["file"] else ""
                typer.echo(f"  {row['key_id']}{place}{'' if row['valid'] else ' (does not count)'}")


def _keys_json(made: tuple[NewKey, ...]) -> list[dict[str, str]]:
    return [{"role": key.role, "key_id": key.key_id, "file": str(key.path)} for key in made]


def _print_new(made: tuple[NewKey, ...]) -> None:
    from training.promotion.keys import OFFLINE_ROLES

    for key in made:
        place = "goes offline: a stick in a safe" if key.role in OFFLINE_ROLES else "stays, for `refresh`"
        typer.echo(f"{key.path}: {key.role}, {key.key_id}; {place}")
    if len([key for key in made if key.role == "root"]) > 1:
        typer.echo("root keys belong in different places: one that burns must not take the other with it")
