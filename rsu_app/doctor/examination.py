"""The whole examination of a box: what is read, in which order, and which check judges it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

from roadgrip.errors import ConfigurationError, RoadgripError
from rsu_app.doctor import machine_reading as machine
from rsu_app.doctor import unit_reading as unit
from rsu_app.doctor.findings import Finding, failed
from rsu_app.doctor.machine_checks import (
    backup_finding,
    clock_finding,
    disk_finding,
    disk_speed_finding,
    log_finding,
    memory_finding,
    processor_finding,
    service_finding,
    udp_buffer_finding,
)
from rsu_app.doctor.seen import SettingsSeen
from rsu_app.doctor.unit_checks import (
    bundle_finding,
    database_finding,
    port_finding,
    repository_finding,
    sections_finding,
    settings_finding,
    traffic_finding,
    trust_finding,
    unit_findings,
)
from rsu_app.settings import Settings, load_settings

SERVICE = "roadgrip-rsu"

Look: TypeAlias = Callable[[], Iterable[Finding]]
"""Reads something and judges it."""


def examine(
    config_file: Path | None, *, visit: bool, backups: Path, on_step: Callable[[str], None] = lambda _: None
) -> Iterator[Finding]:
    """Give the findings, one after the other. The unit may run meanwhile, or not.

    Args:
        config_file: Of the settings; None takes the defaults and the environment.
        visit: Whether the repository of releases is looked at, which may take a minute.
        backups: Folder of the backups.
        on_step: Is told what is looked at now.
    """
    source = "no file: the defaults, and the environment" if config_file is None else str(config_file)
    try:
        settings = load_settings(config_file)
    except ConfigurationError as error:
        yield settings_finding(SettingsSeen(source, problem=str(error)))
        # Of the rest only the machine can be judged.
        yield from _looked_at(_box_looks(None, Path.cwd(), lines_dropped_count=0), on_step=on_step)
        return
    yield settings_finding(SettingsSeen(source))
    said, problem = unit.running_status(settings)
    process = None if said is None else str(said["process"]["process_number"])
    seen = unit.unit_seen(settings, said, problem=problem)
    yield from unit_findings(seen)
    looks = {
        **_file_looks(settings, visit=visit, backups=backups),
        **_door_looks(settings, process, runs=seen.runs),
        **_box_looks(process, settings.database.path.absolute().parent, lines_dropped_count=seen.lines_dropped_count),
    }
    yield from _looked_at(looks, on_step=on_step)


def looked(name: str, look: Look) -> list[Finding]:
    """Return what a look comes to; a thing that cannot even be looked at is a finding, too."""
    try:
        return list(look())
    except (OSError, RoadgripError) as error:
        return [failed(name, f"cannot be looked at: {error}", "sudo -u roadgrip roadgrip-rsu doctor")]


def _looked_at(looks: Mapping[str, Look], *, on_step: Callable[[str], None]) -> Iterator[Finding]:
    for name, look in looks.items():
        on_step(name)
        yield from looked(name, look)


def _file_looks(settings: Settings, *, visit: bool, backups: Path) -> dict[str, Look]:
    def database() -> Iterator[Finding]:
        seen, now_unix_s = unit.database_seen(settings), time.time()
        yield database_finding(seen)
        yield traffic_finding(seen, now_unix_s=now_unix_s)
        yield clock_finding(
            machine.clock_seen(
                newest_stored_unix_s=seen.newest_received_unix_s, speedup_ratio=settings.clock.speedup_ratio
            )
        )

    return {
        "sections": lambda: [sections_finding(unit.sections_seen(settings))],
        "bundle": lambda: [bundle_finding(unit.bundle_seen(settings))],
        "releases": lambda: [repository_finding(unit.repository_seen(settings, visit=visit), now_unix_s=time.time())],
        "keys": lambda: [trust_finding(unit.trust_seen(settings), now_unix_s=time.time())],
        "database": database,
        "backup": lambda: [backup_finding(machine.backup_seen(backups), now_unix_s=time.time())],
    }


def _door_looks(settings: Settings, process: str | None, *, runs: bool) -> dict[str, Look]:
    looks: dict[str, Look] = {"ports": lambda: [port_finding(port) for port in unit.ports_seen(settings, ours=runs)]}
    if settings.udp.enabled:
        asked_bytes = settings.udp.receive_buffer_bytes
        looks["udp buffer"] = lambda: [udp_buffer_finding(machine.udp_buffer_seen(asked_bytes, process))]
    return looks


def _box_looks(process: str | None, folder: Path, *, lines_dropped_count: int) -> dict[str, Look]:
    def disk() -> Iterator[Finding]:
        seen = machine.disk_seen(folder)
        yield disk_finding(seen)
        if seen.sync_s:
            yield disk_speed_finding(seen)

    return {
        "disk": disk,
        "memory": lambda: [memory_finding(machine.memory_seen(process))],
        "processor": lambda: [processor_finding(machine.processor_seen(process))],
        "service": lambda: [service_finding(machine.service_seen(SERVICE), name=SERVICE)],
        "log": lambda: [log_finding(machine.log_seen(folder), lines_dropped_count=lines_dropped_count)],
    }
