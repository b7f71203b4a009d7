"""What an operator of a unit sees and orders, while it runs and while it does not."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any, TypeVar

from roadgrip.errors import ConfigurationError
from roadgrip.records import Rejected
from rsu_app.adapters.http.control import ControlDesk
from rsu_app.bootstrap import Parts, build, load_sections, software_version
from rsu_app.domain.drift import worst
from rsu_app.domain.rollout import ShelvedBundle
from rsu_app.observability import Metrics
from rsu_app.rollout_wiring import source_of
from rsu_app.settings import Settings
from rsu_app.usecases import SectionFriction

T = TypeVar("T")
WORST_COUNT = 5
"""Features that the status names."""


def control_desk(parts: Parts) -> ControlDesk:
    """Return what takes the orders for a running unit."""
    return ControlDesk(
        rollout=parts.rollout,
        source_of=lambda address: source_of(parts.settings, address, clock=parts.clock),
        status=lambda: unit_status(parts),
    )


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


async def unit_status(parts: Parts) -> dict[str, Any]:
    """Return everything an operator looks at, as JSON has it."""
    unit, rollout = parts.unit, parts.rollout.status
    await unit.watch_drift()
    readiness = await unit.readiness()
    manifest = unit.model_manifest
    return {
        "version": software_version(),
        "at": datetime.fromtimestamp(parts.clock.unix_s(), tz=UTC).isoformat(timespec="seconds"),
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
    }


def _section_status(parts: Parts, section_id: str) -> dict[str, Any]:
    friction, advisory = parts.unit.current_friction(section_id), parts.unit.current_advisory(section_id)
    interval = friction.interval if isinstance(friction, SectionFriction) else None
    return {
        "section_id": section_id,
        "passages_count": 0 if interval is None else interval.passages_count,
        "mu_low": None if interval is None else interval.mu_low,
        "mu_new": None if interval is None else interval.mu_new,
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
    outcomes: dict[str, int] = {}
    refused: dict[str, int] = {}
    for labels, count in metrics.passage_counts():
        outcomes[labels["outcome"]] = outcomes.get(labels["outcome"], 0) + count
        if labels["outcome"] == "rejected":
            refused[labels["reason"]] = refused.get(labels["reason"], 0) + count
    total_count = sum(outcomes.values())
    return {
        "since_start_count": total_count,
        "outcomes": outcomes,
        "refused_frac": {reason: count / total_count for reason, count in sorted(refused.items())},
    }
