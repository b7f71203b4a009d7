"""What an operator of a unit sees and orders, while it runs and while it does not."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from roadgrip.errors import ConfigurationError, StoreError
from roadgrip.records import Rejected
from roadgrip.units import mps_to_kph
from rsu_app.adapters.http.control import ControlDesk
from rsu_app.bootstrap import Parts, build, load_sections, software_version
from rsu_app.domain.drift import worst
from rsu_app.domain.rollout import ShelvedBundle
from rsu_app.observability import Metrics
from rsu_app.rollout_wiring import source_of
from rsu_app.settings import Settings
from rsu_app.usecases import Check, Readiness, SectionFriction
from rsu_app.vital_signs import disk_room, memory_limit_bytes, outcome_counts

T = TypeVar("T")
WORST_COUNT = 5
"""Features that the status names."""
REFUSALS_COUNT = 10
"""Kinds of refusals that the status tells, the newest first."""
DRIFT_LOOK_PERIOD_S = 10.0
"""A status that is asked for every second does not look at every section's traffic every second."""
STATUS_LIMIT_COUNT = 400
PATIENCE_S = 3.0
"""What a status waits for the database: a technician wants to be told of a disk that hangs, not to hang with it."""


def control_desk(parts: Parts, *, door_checks: Callable[[], Iterable[Check]] = tuple) -> ControlDesk:
    """Return what takes the orders for a running unit.

    Args:
        parts: Of the unit.
        door_checks: Tells the conditions of its door to the network, if it has one.
    """
    return ControlDesk(
        rollout=parts.rollout,
        source_of=lambda address: source_of(parts.settings, address, clock=parts.clock),
        status=lambda: unit_status(parts, door_checks=door_checks()),
    )


def one_line(parts: Parts) -> str:
    """Return how the unit is in one line, without asking the disk."""
    unit, pulse = parts.unit, parts.store.pulse
    words = ["serving"]
    for section_id in unit.section_ids:
        interval, advisory = unit.current_interval(section_id), unit.current_advisory(section_id)
        vehicles_count = 0 if interval is None or isinstance(interval, Rejected) else interval.passages_count
        advised = "" if isinstance(advisory, Rejected) else f", {mps_to_kph(advisory.speed_mps):.0f} km/h"
        words.append(f"{section_id}: {vehicles_count} vehicles{advised}")
    words.append("no model" if unit.model_manifest is None else f"bundle {unit.model_manifest.bundle_id}")
    committed_ago_s = pulse.committed_ago_s
    words.append("no commit yet" if committed_ago_s is None else f"last commit {committed_ago_s:.0f} s ago")
    return "; ".join(words)[:STATUS_LIMIT_COUNT]


async def out_of_service(settings: Settings, act: Callable[[ControlDesk], Awaitable[T]]) -> T:
    """Return what an order comes to in a unit that does not run: it is put together, obeys, and is put away again.

    Nobody is served meanwhile. What was begun, such as a comparison in the shadow, goes on when the unit is started.
    """
    sections = load_sections(settings)
    metrics = Metrics(version=software_version(), section_ids=(section.section_id for section in sections))
    parts = build(settings, metrics=metrics, sections=sections)
    try:
        await parts.rollout.resume()
        return await act(control_desk(parts))
    finally:
        await parts.unit.close()


def checked_source(settings: Settings, address: str) -> str:
    """Return the address of a repository after the settings were asked whether they know whom to trust.

    Raises:
        ConfigurationError: There is no trusted root, without which nothing is ever taken.
    """
    if settings.updates.trusted_root is None:
        raise ConfigurationError("updates.trusted_root is not set: no release can be trusted without it")
    return address


async def unit_status(parts: Parts, *, door_checks: Iterable[Check] = ()) -> dict[str, Any]:
    """Return everything an operator looks at, as JSON has it; within seconds, whatever the disk does.

    Args:
        parts: Of the unit.
        door_checks: Conditions that belong to its readiness besides its own.
    """
    unit, rollout = parts.unit, parts.rollout.status
    if parts.signs.take_turn(DRIFT_LOOK_PERIOD_S):
        await unit.watch_drift()
    readiness = Readiness((*(await _readiness(parts)).checks, *door_checks))
    manifest = unit.model_manifest
    return {
        "version": software_version(),
        "at": _written(parts.clock.unix_s()),
        "ready": readiness.ready,
        "conditions": [asdict(check) for check in readiness.checks],
        "sections": [_section_status(parts, section_id) for section_id in unit.section_ids],
        "model": {
            "live_bundle_id": None if manifest is None else manifest.bundle_id,
            "table_digests": list(unit.table_digests),
            "stage": rollout.state.stage.value,
            "live": _told(rollout.state.live),
            "previous": _told(rollout.state.previous),
            "candidate": _told(rollout.state.candidate),
            "comparison": None if rollout.comparison is None else asdict(rollout.comparison),
            "wanted_count": rollout.wanted_count,
            "ring": parts.settings.updates.ring,
            "looked_unix_s": rollout.looked_unix_s,
            "last_refusal": None
            if rollout.last_refusal is None
            else {"reason": rollout.last_refusal.reason.value, "detail": rollout.last_refusal.detail},
        },
        "passages": _passages(parts.metrics),
        "traffic": {"per_s": parts.signs.rates_per_s(), "refusals": _refusals(parts)},
        "clock": _clock(parts),
        "disk": await _disk(parts),
        "process": asdict(parts.signs.process()) | {"memory_limit_bytes": memory_limit_bytes()},
        "log_lines_dropped_count": int(parts.metrics.log_lines_dropped_count()),
    }


async def _readiness(parts: Parts) -> Readiness:
    """Return the readiness of a unit, also of one whose disk does not answer."""
    stuck_s = parts.store.pulse.busy_s
    if stuck_s < PATIENCE_S:
        try:
            return await asyncio.wait_for(parts.unit.readiness(), PATIENCE_S)
        except TimeoutError:
            stuck_s = max(PATIENCE_S, parts.store.pulse.busy_s)
    return Readiness((Check("store", ok=False, detail=f"the same write has been under way for {stuck_s:.0f} s"),))


async def _disk(parts: Parts) -> dict[str, Any]:
    """Return what is known about the disk; what only the database knows is None while it does not answer."""
    path, pulse = parts.settings.database.path, parts.store.pulse
    room = disk_room(path.parent)
    passages_count = None
    if pulse.busy_s < PATIENCE_S:
        try:
            passages_count = (await asyncio.wait_for(parts.store.counts(), PATIENCE_S)).passages_count
        except (StoreError, TimeoutError):
            passages_count = None
    return {
        "free_bytes": None if room is None else room.free_bytes,
        "size_bytes": None if room is None else room.size_bytes,
        "database_bytes": _size_bytes(path),
        "log_bytes": _size_bytes(path.with_name(path.name + "-wal")),
        "passages_count": passages_count,
        "committed_ago_s": pulse.committed_ago_s,
        "queued_count": pulse.queued_count,
        "queue_limit_count": parts.settings.database.queue_limit_count,
        "notes": list(parts.store.notes),
    }


def _size_bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _clock(parts: Parts) -> dict[str, Any]:
    signs = parts.signs.clock()
    return {
        "ok": signs.wall.ok,
        "detail": signs.wall.detail,
        "synchronised": signs.synchronised,
        "max_error_s": signs.max_error_s,
        "steps": asdict(signs.steps),
        "speedup_ratio": parts.settings.clock.speedup_ratio,
    }


def _refusals(parts: Parts) -> list[dict[str, Any]]:
    now_s, now_unix_s = parts.signs.now_s(), parts.clock.unix_s()
    return [
        {
            "at": _written(now_unix_s - (now_s - each.at_s)),
            "ago_s": now_s - each.at_s,
            "reason": each.reason,
            "section": each.section,
            "via": each.via,
            "detail": each.detail,
            "refused_count": each.refused_count,
        }
        for each in parts.metrics.latest_refusals.newest()[:REFUSALS_COUNT]
    ]


def _written(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, tz=UTC).isoformat(timespec="seconds")


def _section_status(parts: Parts, section_id: str) -> dict[str, Any]:
    friction, advisory = parts.unit.current_friction(section_id), parts.unit.current_advisory(section_id)
    interval = friction.interval if isinstance(friction, SectionFriction) else None
    return {
        "section_id": section_id,
        "passages_count": 0 if interval is None else interval.passages_count,
        "mu_low": None if interval is None else interval.mu_low,
        "mu_new": None if interval is None else interval.mu_new,
        "at_least": isinstance(friction, SectionFriction) and friction.at_least,
        "newest_age_s": None if interval is None else interval.newest_age_s,
        "confidence": None if isinstance(advisory, Rejected) else advisory.confidence.value,
        "advised_mps": None if isinstance(advisory, Rejected) else advisory.speed_mps,
        "advice_reason": None if isinstance(advisory, Rejected) else advisory.reason.value,
        "drift": _drift(parts, section_id),
    }


def _drift(parts: Parts, section_id: str) -> dict[str, Any] | None:
    report = parts.unit.current_drift(section_id)
    if report is None or isinstance(report, Rejected):
        return None
    return {
        "rows_count": report.rows_count,
        "own_road": report.own_road,
        "drifted_count": report.drifted_count,
        "own_rows_count": report.own_rows_count,
        "own_drifted_count": report.own_drifted_count,
        "out_of_envelope_frac": report.out_of_envelope_frac,
        "estimates_outside_frac": report.estimates_outside_frac,
        "alarms": [alarm.value for alarm in report.alarms],
        "worst": [
            {"feature": each.name, "psi_ratio": each.psi_ratio, "ks_frac": each.ks_frac}
            for each in worst(report.own_features or report.features, WORST_COUNT)
        ],
    }


def _told(bundle: ShelvedBundle | None) -> dict[str, Any] | None:
    return None if bundle is None else asdict(bundle)


def _passages(metrics: Metrics) -> dict[str, Any]:
    """Return how passages were answered since the start, and for what reasons they were refused."""
    outcomes = outcome_counts(metrics)
    refused: dict[str, int] = {}
    for labels, count in metrics.passage_counts():
        if labels["outcome"] == "rejected":
            refused[labels["reason"]] = refused.get(labels["reason"], 0) + count
    total_count = sum(outcomes.values())
    return {
        "since_start_count": total_count,
        "outcomes": outcomes,
        "refused_frac": {reason: count / total_count for reason, count in sorted(refused.items())},
    }
