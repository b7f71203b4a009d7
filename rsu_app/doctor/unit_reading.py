"""What is read of the unit: its files, its ports, and the running one itself. Changes nothing of it."""

from __future__ import annotations

import errno
import getpass
import json
import os
import pwd
import socket
import stat
import tempfile
import time
from contextlib import closing
from datetime import datetime
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from roadgrip.errors import RoadgripError
from rsu_app.adapters.store import moved_aside, newest_received_unix_s
from rsu_app.adapters.updates import FetchLimits, TufReleaseSource
from rsu_app.bootstrap import check_database, check_maps, load_sections, load_trust, open_door, software_version
from rsu_app.control_client import ControlError, ask
from rsu_app.doctor.seen import (
    BundleSeen,
    DatabaseSeen,
    PortSeen,
    PortState,
    RepositorySeen,
    SectionsSeen,
    TrustSeen,
    UnitSeen,
)
from rsu_app.observability import Metrics
from rsu_app.rollout_ports import UpdateRefusal
from rsu_app.rollout_wiring import loading_of, shelf_of, socket_path
from rsu_app.settings import Settings
from rsu_app.signatures import SignatureMode
from rsu_app.usecases.booting import boot

VISIT_LIMITS = FetchLimits(silence_s=10.0, total_s=60.0)
ANSWER_TIMEOUT_S = 15.0
_OTHERS = stat.S_IROTH | stat.S_IWOTH | stat.S_IWGRP


def running_status(settings: Settings) -> tuple[dict[str, Any] | None, str]:
    """Return what the running unit answers, None without one; and why it cannot be asked, empty if it can."""
    try:
        return ask(socket_path(settings), "/status", timeout_s=ANSWER_TIMEOUT_S), ""
    except ControlError as error:
        return None, str(error)


def unit_seen(settings: Settings, said: dict[str, Any] | None, *, problem: str) -> UnitSeen:
    """Return how the running unit is by its own account; arguments as `running_status` gave them."""
    path = socket_path(settings)
    try:
        others_may_order = bool(path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO))
    except OSError:
        others_may_order = False
    if said is None:
        return UnitSeen(socket_path=str(path), runs=False, problem=problem)
    return UnitSeen(
        socket_path=str(path),
        runs=True,
        unmet=tuple(f"{c['name']}: {c['detail']}" for c in said["conditions"] if c["required"] and not c["ok"]),
        committed_ago_s=said["disk"]["committed_ago_s"],
        lines_dropped_count=said["log_lines_dropped_count"],
        others_may_order=others_may_order,
    )


def sections_seen(settings: Settings) -> SectionsSeen:
    """Return the maps, each tried for whether it fits the frames."""
    try:
        sections = load_sections(settings)
        check_maps(sections, signer=load_trust(settings).signer)
    except RoadgripError as error:
        return SectionsSeen(problem=str(error))
    return SectionsSeen(section_ids=tuple(section.section_id for section in sections))


def bundle_seen(settings: Settings) -> BundleSeen:
    """Return the model that a start would begin with."""
    metrics = Metrics(version=software_version(), section_ids=())
    try:
        started = boot(shelf_of(settings), loading_of(settings, metrics=metrics))
    except RoadgripError as error:
        return BundleSeen(problem=str(error))
    if started.model is None:
        return BundleSeen(problem="; ".join(started.notes))
    return BundleSeen(bundle_id=started.model.manifest.bundle_id, notes=started.notes)


def repository_seen(settings: Settings, *, visit: bool) -> RepositorySeen:
    """Return what a visit to the repository comes to. Nothing of it is kept: the unit remembers nothing of this one.

    Args:
        settings: Name it.
        visit: Whether to go there; it may take a minute.
    """
    updates = settings.updates
    seen = RepositorySeen(source=updates.source, rooted=updates.trusted_root is not None, ring=updates.ring)
    if not visit or not updates.source or updates.trusted_root is None:
        return seen
    with tempfile.TemporaryDirectory(prefix="roadgrip-doctor-") as folder:
        cache = Path(folder) / "cache"
        source = TufReleaseSource(
            updates.source,
            trusted_root=updates.trusted_root,
            cache_folder=cache,
            unix_s=time.time,
            limits=VISIT_LIMITS,
        )
        newest = shelf_of(settings).state().newest_sequence_number
        found = source.fetch(updates.ring, newer_than=newest, into=Path(folder) / "incoming")
        refusal = found if isinstance(found, UpdateRefusal) else None
        return RepositorySeen(
            source=seen.source,
            rooted=True,
            ring=seen.ring,
            visited=True,
            problem="" if refusal is None else f"{refusal.reason.value}: {refusal.detail}",
            reason="" if refusal is None else refusal.reason.value,
            expires_unix_s=_first_expiry_unix_s(cache),
        )


def database_seen(settings: Settings) -> DatabaseSeen:
    """Return the database, read as a whole: seconds for a large one."""
    path = settings.database.path.absolute()
    folder = next((place for place in path.parents if place.is_dir()), Path("/"))
    exists = path.exists()
    found = path.stat() if exists else folder.stat()
    log = path.with_name(path.name + "-wal")
    writable = os.access(folder, os.W_OK | os.X_OK) and (not exists or os.access(path, os.R_OK | os.W_OK))
    newest_unix_s = newest_received_unix_s(path) if exists else 0.0
    return DatabaseSeen(
        path=str(path),
        exists=exists,
        size_bytes=found.st_size if exists else 0,
        log_bytes=log.stat().st_size if log.exists() else 0,
        others_may_read=exists and bool(found.st_mode & stat.S_IROTH),
        writable=writable,
        problems=tuple(check_database(path)) if exists and writable else (),
        newest_received_unix_s=newest_unix_s or None,
        damaged=tuple(each.name for each in moved_aside(path)),
        account=_account(),
        owner=_name_of(found.st_uid),
        folder_owner=_name_of(folder.stat().st_uid),
    )


def ports_seen(settings: Settings, *, ours: bool) -> list[PortSeen]:
    """Return the ports that the settings name.

    Args:
        settings: Name them.
        ours: Whether a unit of these settings runs.
    """
    http, udp = settings.http, settings.udp
    wanted = [
        (
            "http",
            http.host,
            http.port,
            socket.SOCK_STREAM,
            http.tls_certificate_file is not None,
        )
    ]
    if udp.enabled:
        required = udp.signatures is SignatureMode.REQUIRED
        wanted.append(("udp", udp.host, udp.port, socket.SOCK_DGRAM, required))
    return [
        PortSeen(
            name=name,
            host=host,
            port=port,
            state=_state_of(host, port, kind),
            loopback=ip_address(host).is_loopback,
            ours=ours,
            protected=protected,
        )
        for name, host, port, kind, protected in wanted
    ]


def trust_seen(settings: Settings) -> TrustSeen:
    """Return keys and certificates."""
    from roadgrip.trust import trust_warnings

    secrets = (settings.signing.credential_file, settings.http.tls_key_file, settings.operators.tokens_file)
    exposed = tuple(str(path) for path in secrets if path is not None and _others_may_read(path))
    try:
        trust = load_trust(settings)
        # A key that others may read is refused by the door; it is told of as what it is.
        door = None if exposed else open_door(settings)
        section_ids = [section.section_id for section in load_sections(settings)]
    except RoadgripError as error:
        return TrustSeen(problem=str(error), exposed=exposed)
    tls = None if door is None else door.tls
    certificate = None if trust.signer is None else trust.signer.certificate
    return TrustSeen(
        signs=trust.signer is not None,
        believes=SignatureMode.OFF not in {settings.udp.signatures, settings.http.signatures},
        warnings=trust_warnings(trust, now_unix_s=time.time(), section_ids=section_ids),
        signature_ends_unix_s=None if certificate is None else certificate.valid_until_unix_s,
        tls=tls is not None,
        tls_ends_unix_s=None if tls is None else tls.ends_unix_s,
        exposed=exposed,
    )


def _others_may_read(path: Path) -> bool:
    try:
        return bool(path.stat().st_mode & _OTHERS)
    except OSError:
        return False


def _state_of(host: str, port: int, kind: socket.SocketKind) -> PortState:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with closing(socket.socket(family, kind)) as link:
        if kind is socket.SOCK_STREAM:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            link.bind((host, port))
            if kind is socket.SOCK_STREAM:
                # Only listening finds out about another who listens, where both let the address be used again.
                link.listen()
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return PortState.TAKEN
            return PortState.FORBIDDEN if error.errno == errno.EACCES else PortState.NO_ADDRESS
    return PortState.FREE


def _first_expiry_unix_s(cache: Path) -> float | None:
    """Return when the first of the signatures that a visit has left in its cache expires."""
    moments = []
    for path in cache.rglob("*.json"):
        try:
            written = json.loads(path.read_bytes())["signed"]["expires"]
            moments.append(datetime.fromisoformat(written).timestamp())
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return min(moments, default=None)


def _account() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid {os.getuid()}"


def _name_of(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"uid {uid}"
