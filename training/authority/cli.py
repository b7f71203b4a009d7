"""roadgrip-authority: says who may speak on the air, in the folder of an authority."""

from __future__ import annotations

import json
import secrets
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from rich.console import Console
from rich.table import Table

from roadgrip.certificates import REVOCATIONS_LIMIT_COUNT, certificate_in_pem, read_revocations
from roadgrip.errors import ConfigurationError, RoadgripError
from roadgrip.sign1 import public_key_in
from roadgrip.signing import authorities_of
from training.authority.folder import DAY_S, AuthorityFolder, IssuedFile
from training.authority.register import Entry, chosen_entries

if TYPE_CHECKING:
    from roadgrip.certificates import Certificate

DEFAULT_FOLDER = Path("authority")
USAGE_ERROR = 2

app = typer.Typer(
    name="roadgrip-authority",
    help="Certify road side units and pseudonyms of vehicles; revoke what was certified. docs/security.md explains.",
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Folder = Annotated[
    Path,
    typer.Option("--folder", metavar="FOLDER", envvar="ROADGRIP_AUTHORITY", help="The authority's; keep it off units."),
]
PasswordFile = Annotated[
    Path | None,
    typer.Option("--password-file", metavar="FILE", help="Its first line encrypts the authority's private keys."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for machines.")]
Wanted = Annotated[
    list[str], typer.Argument(metavar="ID|NAME...", help="Ids (or their beginnings), units, or whole batches.")
]


@app.command()
def init(folder: Folder = DEFAULT_FOLDER, *, password_file: PasswordFile = None, as_json: AsJson = False) -> None:
    """Begin an authority: its first pair of keys, in an empty or new folder."""
    authority = _authority(folder, password_file)
    public = authority.begin()
    _say(
        {"public_key": str(public), "authority_id": _newest_id(authority)},
        f"authority {_newest_id(authority)}: bring {public} to the authorities folder of every unit and vehicle",
        as_json=as_json,
    )


@app.command()
def rotate(folder: Folder = DEFAULT_FOLDER, *, password_file: PasswordFile = None, as_json: AsJson = False) -> None:
    """Make the next pair of keys, which signs from now on; what the one before has signed stays valid.

    First bring the new public key to every unit and vehicle beside the old one, then issue with it. Take the old one
    away from them when `show` says that nothing it has signed is in date.
    """
    authority = _authority(folder, password_file)
    authority.entries()
    public = authority.new_key()
    _say(
        {"public_key": str(public), "authority_id": _newest_id(authority)},
        f"authority {_newest_id(authority)} signs from now on: bring {public} to every unit and vehicle first",
        as_json=as_json,
    )


@app.command("issue-unit")
def issue_unit(
    name: Annotated[str, typer.Argument(help="The unit's name, for the register and the file.")],
    *,
    folder: Folder = DEFAULT_FOLDER,
    section: Annotated[
        list[str] | None,
        typer.Option("--section", metavar="ID", help="A section it may speak for; repeat it. Left out: all."),
    ] = None,
    days: Annotated[int, typer.Option(min=1, max=3_650, help="How long the certificate holds.")] = 365,
    public_key: Annotated[
        Path | None,
        typer.Option("--public-key", metavar="FILE", help="Public key (PEM) made on the unit; only certify it."),
    ] = None,
    password_file: PasswordFile = None,
    as_json: AsJson = False,
) -> None:
    """Certify a road side unit: a new private key with its certificate, or a certificate for the unit's own key.

    Example: roadgrip-authority issue-unit rv3-km12 --section long-turn --section s-turn
    """
    issued = _authority(folder, password_file).issue_unit(
        name,
        section_ids=tuple(section or ()),
        days_count=days,
        now_unix_s=_now(),
        random_bytes=secrets.token_bytes,
        public_key=public_key,
    )
    told = f"{issued.path}: the unit's `signing.credential_file`; bring it there and delete it here"
    if public_key is not None:
        told = f"{issued.path}: put it behind the unit's private key, in one file"
    _say(_issued_json(issued), f"certificate {issued.certificate.certificate_id.hex()}\n{told}", as_json=as_json)


@app.command("issue-pseudonyms")
def issue_pseudonyms(
    name: Annotated[str, typer.Argument(help="Name of the batch; it should not name the vehicle.")],
    *,
    folder: Folder = DEFAULT_FOLDER,
    count: Annotated[int, typer.Option(min=1, max=1_000, help="How many pseudonyms.")] = 20,
    days: Annotated[int, typer.Option(min=1, max=92, help="How long they hold.")] = 7,
    starts_in_days: Annotated[int, typer.Option(min=0, max=366, help="They begin so many days from now.")] = 0,
    password_file: PasswordFile = None,
    as_json: AsJson = False,
) -> None:
    """Make a batch of pseudonyms for one vehicle: private keys with certificates that name nobody.

    Example: roadgrip-authority issue-pseudonyms 2026-w07-0001 --starts-in-days 2
    """
    now_unix_s = _now()
    issued = _authority(folder, password_file).issue_pseudonyms(
        name,
        count=count,
        days_count=days,
        start_unix_s=now_unix_s + starts_in_days * DAY_S,
        now_unix_s=now_unix_s,
        random_bytes=secrets.token_bytes,
    )
    place = issued[0].path.parent
    dates = f"{_day(issued[0].certificate.valid_from_unix_s)} to {_day(issued[0].certificate.valid_until_unix_s)}"
    _say(
        {"folder": str(place), "issued": [_issued_json(each) for each in issued]},
        f"{len(issued)} pseudonyms, {dates}\n{place}: a vehicle's --credential; bring it there and delete it here",
        as_json=as_json,
    )


@app.command()
def revoke(
    wanted: Wanted,
    *,
    folder: Folder = DEFAULT_FOLDER,
    why: Annotated[str, typer.Option(metavar="TEXT", help="Why, for the register.")] = "",
    as_json: AsJson = False,
) -> None:
    """Revoke certificates. Nobody knows before the next `publish` was brought to units and vehicles."""
    authority = _authority(folder, None)
    news = authority.revoke(chosen_entries(authority.entries(), wanted), why=why, now_unix_s=_now())
    _say(
        {"revoked": [entry.certificate_id for entry in news]},
        f"{len(news)} certificates revoked; `roadgrip-authority publish` makes the list that says so",
        as_json=as_json,
    )


@app.command()
def publish(
    *,
    folder: Folder = DEFAULT_FOLDER,
    days: Annotated[int, typer.Option(min=1, max=366, help="By when the next list is due.")] = 7,
    password_file: PasswordFile = None,
    as_json: AsJson = False,
) -> None:
    """Sign the list of revoked certificates; publish again before it is due, also when nothing has changed."""
    authority = _authority(folder, password_file)
    revoked = authority.publish(days_count=days, now_unix_s=_now())
    _say(
        {
            "path": str(authority.revocations_path),
            "issued_unix_s": revoked.issued_unix_s,
            "due_unix_s": revoked.due_unix_s,
            "revoked_count": len(revoked.certificate_ids),
            "limit_count": REVOCATIONS_LIMIT_COUNT,
        },
        f"{authority.revocations_path}: {len(revoked.certificate_ids)} certificates; the next is due "
        f"{_moment(revoked.due_unix_s)}\nbring it to `signing.revocations_file` of units and --revocations of vehicles",
        as_json=as_json,
    )


@app.command("list")
def list_certificates(
    *,
    folder: Folder = DEFAULT_FOLDER,
    everything: Annotated[bool, typer.Option("--all", help="Those that have ended, too.")] = False,
    as_json: AsJson = False,
) -> None:
    """List the certificates that were issued."""
    now_unix_s = _now()
    entries = [
        entry
        for entry in _authority(folder, None).entries().values()
        if everything or entry.valid_until_unix_s >= now_unix_s
    ]
    if as_json:
        typer.echo(json.dumps([_entry_json(entry, now_unix_s=now_unix_s) for entry in entries], indent=1))
        return
    table = Table(box=None)
    for name in ("id", "role", "name", "sections", "from", "until", "state"):
        # Ids and names are copied from here into the next command.
        table.add_column(name, no_wrap=name != "sections", overflow="fold")
    for entry in entries:
        sections = ", ".join(entry.section_ids) or ("all" if entry.role.value == "unit" else "")
        dates = (_day(entry.valid_from_unix_s), _day(entry.valid_until_unix_s))
        state = entry.state(now_unix_s=now_unix_s)
        table.add_row(entry.certificate_id, entry.role.value, entry.name, sections, *dates, state)
    Console().print(table)


@app.command()
def show(
    file: Annotated[
        Path | None, typer.Argument(help="A credential, certificate or list; left out, the authority itself.")
    ] = None,
    *,
    folder: Folder = DEFAULT_FOLDER,
    as_json: AsJson = False,
) -> None:
    """Show what a file says, or how the authority stands: its keys and what each still vouches for."""
    authority = _authority(folder, None)
    content = _standing(authority) if file is None else _content_of(file, authority)
    if as_json:
        typer.echo(json.dumps(content, indent=1))
        return
    for key, value in content.items():
        typer.echo(f"{key}: {value}")


def run() -> None:
    """Run the command line; what cannot be is one line and exit code 2."""
    try:
        app()
    except RoadgripError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}")


def _fail(line: str) -> NoReturn:
    typer.echo(f"roadgrip-authority: {line}", err=True)
    raise SystemExit(USAGE_ERROR)


def _authority(folder: Path, password_file: Path | None) -> AuthorityFolder:
    if password_file is None:
        return AuthorityFolder(folder)
    password = password_file.read_bytes().split(b"\n", 1)[0].rstrip(b"\r")
    if not password:
        raise ConfigurationError(f"{password_file} holds no password in its first line")
    return AuthorityFolder(folder, password)


def _newest_id(authority: AuthorityFolder) -> str:
    return list(authority.key_ids())[-1]


def _standing(authority: AuthorityFolder) -> dict[str, Any]:
    now_unix_s = _now()
    entries = authority.entries().values()
    living = [entry for entry in entries if entry.state(now_unix_s=now_unix_s) in {"in date", "to come"}]
    vouches = Counter(entry.authority_id for entry in living)
    standing: dict[str, Any] = {
        f"authority {authority_id}": f"{path}, {vouches[authority_id]} certificates in date or to come"
        for authority_id, path in authority.key_ids().items()
    }
    standing["units in date"] = sum(entry.role.value == "unit" for entry in living)
    standing["pseudonyms in date"] = sum(entry.role.value == "vehicle" for entry in living)
    standing["revoked"] = sum(entry.revoked_unix_s is not None for entry in entries)
    if authority.revocations_path.exists():
        standing |= _content_of(authority.revocations_path, authority)
    return standing


def _content_of(file: Path, authority: AuthorityFolder) -> dict[str, Any]:
    content = file.read_bytes()
    if b"-----BEGIN" in content:
        return _certificate_json(certificate_in_pem(content))
    keys = authorities_of([public_key_in(path.read_bytes()) for path in authority.public_keys()])
    try:
        revoked = read_revocations(content, keys)
    except RoadgripError as error:
        raise ConfigurationError(f"{file} is neither a certificate nor a list of this authority: {error}") from error
    return {
        "list": str(file),
        "list issued": _moment(revoked.issued_unix_s),
        "list next due": _moment(revoked.due_unix_s),
        "list overdue": _now() > revoked.due_unix_s,
        "list names": sorted(each.hex() for each in revoked.certificate_ids),
    }


def _issued_json(issued: IssuedFile) -> dict[str, Any]:
    return {"path": str(issued.path), **_certificate_json(issued.certificate)}


def _certificate_json(certificate: Certificate) -> dict[str, Any]:
    return {
        "certificate_id": certificate.certificate_id.hex(),
        "authority_id": certificate.authority_id.hex(),
        "role": certificate.role.value,
        "section_ids": list(certificate.section_ids),
        "valid_from": _moment(certificate.valid_from_unix_s),
        "valid_until": _moment(certificate.valid_until_unix_s),
        "public_key": certificate.public_key.hex(),
        "size_bytes": len(certificate.encoded),
    }


def _entry_json(entry: Entry, *, now_unix_s: int) -> dict[str, Any]:
    return {
        "certificate_id": entry.certificate_id,
        "authority_id": entry.authority_id,
        "role": entry.role.value,
        "name": entry.name,
        "section_ids": list(entry.section_ids),
        "valid_from_unix_s": entry.valid_from_unix_s,
        "valid_until_unix_s": entry.valid_until_unix_s,
        "issued_unix_s": entry.issued_unix_s,
        "revoked_unix_s": entry.revoked_unix_s,
        "why": entry.why,
        "state": entry.state(now_unix_s=now_unix_s),
    }


def _say(content: dict[str, Any], text: str, *, as_json: bool) -> None:
    typer.echo(json.dumps(content, indent=1) if as_json else text)


def _now() -> int:
    return int(time.time())


def _moment(unix_s: int) -> str:
    return time.strftime("%Y-%m-%dT%H:%MZ", time.gmtime(unix_s))


def _day(unix_s: int) -> str:
    return time.strftime("%Y-%m-%d", time.gmtime(unix_s))
