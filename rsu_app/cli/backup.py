"""`roadgrip-rsu backup` and `restore`: what a unit knows, carried to a safe place and back."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeElapsedColumn

from rsu_app.backup_archive import BackupError
from rsu_app.cli.interruption import ended_like_ctrl_c
from rsu_app.cli.rollout import this_account
from rsu_app.moments import shown_moment
from rsu_app.settings import CONFIG_VARIABLE, load_settings

FILE_ENDING = ".tar.gz"

BackupPath = Annotated[Path, typer.Argument(metavar="FILE.tar.gz", help="The backup.")]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", "-c", envvar=CONFIG_VARIABLE, help="TOML file with settings.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")]


def backup(path: BackupPath, *, config_file: ConfigFile = None, as_json: AsJson = False) -> None:
    """Write passages, ledger, bundles and settings into one file. The unit may run meanwhile.

    Keys are not in it. It replaces no file, and is there whole or not at all.

    **Example**

        roadgrip-rsu backup /media/stick/fv27-2026-01-31.tar.gz
    """
    from rsu_app.backup_wiring import make_backup

    if not path.name.endswith(FILE_ENDING):
        raise BackupError(f"{path}: a backup is packed; let its name end in {FILE_ENDING}")
    settings = load_settings(config_file)
    with ended_like_ctrl_c(), _progress() as on_progress:
        manifest = make_backup(settings, path, config_file=config_file, now_unix_s=time.time(), on_progress=on_progress)
    size_bytes = path.stat().st_size
    if as_json:
        told = {
            "file": str(path),
            "bytes": size_bytes,
            "revision": manifest.revision,
            "files": [file.name for file in manifest.files],
        }
        typer.echo(json.dumps(told, indent=1))
        return
    typer.echo(f"written: {path}, {size_bytes} bytes, {len(manifest.files)} files, schema {manifest.revision}")


def restore(
    path: BackupPath,
    *,
    although_running: Annotated[
        bool,
        typer.Option(
            "--although-running",
            help="Do not wait for the unit to stop. It goes on with what was set aside until it is started anew.",
        ),
    ] = False,
    actor: Annotated[str, typer.Option("--by", help="Who; it goes into the ledger.", show_default="this account")] = "",
    config_file: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Put a backup in the place of what this unit has. What was there is kept beside it, with the time in its name.

    Everything is examined before anything is touched: digests, database, schema; older schemas are migrated. Settings
    and keys stay as they are; those of the backup can be read with `tar -xzf FILE settings`.

    **Example**

        systemctl stop roadgrip-rsu
        roadgrip-rsu restore /media/stick/fv27-2026-01-31.tar.gz
        systemctl start roadgrip-rsu
    """
    from rsu_app.backup_wiring import restore_backup

    settings = load_settings(config_file)
    with ended_like_ctrl_c(), _progress() as on_progress:
        restored = restore_backup(
            settings,
            path,
            actor=actor or this_account(),
            although_running=although_running,
            now_unix_s=time.time(),
            on_progress=on_progress,
        )
    manifest = restored.manifest
    if as_json:
        told = {
            "made_unix_s": manifest.made_unix_s,
            "unit": manifest.unit,
            "revision_before": manifest.revision,
            "revision": restored.revision,
            "set_aside": [str(place) for place in restored.set_aside],
        }
        typer.echo(json.dumps(told, indent=1))
        return
    named = f" of {manifest.unit}" if manifest.unit else ""
    migrated = "" if manifest.revision == restored.revision else f", migrated from schema {manifest.revision}"
    typer.echo(f"restored: what was backed up{named} at {shown_moment(manifest.made_unix_s)}{migrated}")
    for place in restored.set_aside:
        typer.echo(f"kept: {place}; delete it when all is well")


@contextmanager
def _progress() -> Iterator[_OnProgress]:
    """Give what shows how far something is, on the other channel, so that --json stays JSON."""
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TimeElapsedColumn(),
        console=(console := Console(stderr=True)),
        disable=not console.is_terminal,
        transient=True,
    ) as bar:
        yield _OnProgress(bar)


class _OnProgress:
    """One bar, which begins anew with every step."""

    def __init__(self, bar: Progress) -> None:
        self._bar = bar
        self._task = bar.add_task("", total=None)
        self._doing = ""

    def __call__(self, doing: str, done_bytes: int, of_bytes: int) -> None:
        if doing != self._doing:
            self._doing = doing
            self._bar.reset(self._task, description=doing)
        self._bar.update(self._task, completed=done_bytes, total=of_bytes or None)
