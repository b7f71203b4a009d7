"""The part of the composition root that knows bundles: where they lie, how they load, where releases come from."""

from __future__ import annotations

from importlib.resources import files
from math import nan
from pathlib import Path

import structlog

from roadgrip.records import Rejected
from rsu_app.adapters.updates import FolderShelf, TufReleaseSource
from rsu_app.domain.drift import DriftAlarm
from rsu_app.domain.rollout import Stage
from rsu_app.domain.shadow import ShadowPolicy
from rsu_app.intake import TimedModel
from rsu_app.observability import Metrics
from rsu_app.ports import Clock, FrictionModel, PassageStore
from rsu_app.rollout_ports import BundleShelf, UpdateRefusal
from rsu_app.settings import Settings
from rsu_app.usecases import RoadSideUnit
from rsu_app.usecases.booting import Boot, Loading
from rsu_app.usecases.rollout import Rollout, RolloutStatus

SHELF_FOLDER_NAME = "roadgrip-models"
CACHE_FOLDER_NAME = "repository-cache"
SOCKET_NAME = "control.sock"
FEATURES_SECTIONS_COUNT = 8
"""Up to so many sections each feature has a series of its own; a unit of thousands would have a million."""

_log = structlog.get_logger("roadgrip")


def load_model(settings: Settings) -> FrictionModel:
    """Return the model that the settings ask for, or that came with the software: the factory's.

    Raises:
        BundleError: The bundle must not be trusted.
        FeatureTableError: It was made for another feature table.
    """
    from rsu_app.adapters.inference import load_bundle

    return load_bundle(bundle_path(settings))


def bundle_path(settings: Settings) -> Path:
    """Return the folder of the factory's bundle: the chosen one, or the packaged default."""
    return settings.model.bundle_path or Path(str(files("rsu_app") / "default_bundle"))


def shelf_folder(settings: Settings) -> Path:
    """Return the folder of the shelf of bundles."""
    return settings.updates.folder or settings.database.path.parent / SHELF_FOLDER_NAME


def socket_path(settings: Settings) -> Path:
    """Return where the control socket is."""
    return settings.control.socket_path or shelf_folder(settings) / SOCKET_NAME


def shelf_of(settings: Settings) -> FolderShelf:
    """Return the shelf of bundles; nothing is made before something is put on it."""
    return FolderShelf(shelf_folder(settings))


def loading_of(settings: Settings, *, metrics: Metrics) -> Loading:
    """Return how bundles become models that tell how long they take."""
    from rsu_app.adapters.inference import load_bundle

    return Loading(
        from_folder=lambda folder: TimedModel(load_bundle(folder), metrics=metrics),
        factory=lambda: TimedModel(load_model(settings), metrics=metrics),
    )


def source_of(settings: Settings, address: str, *, clock: Clock) -> TufReleaseSource | None:
    """Return a repository as a source of releases; None without an address or a trusted root.

    Args:
        settings: Say whom to trust.
        address: A URL or a folder; empty for none.
        clock: The wall clock that expiry is judged by.
    """
    root = settings.updates.trusted_root
    if not address or root is None:
        return None
    return TufReleaseSource(
        address,
        trusted_root=root,
        cache_folder=shelf_folder(settings) / CACHE_FOLDER_NAME,
        unix_s=clock.unix_s,
    )


def show_drift(unit: RoadSideUnit, *, metrics: Metrics) -> None:
    """Bring the gauges of drift up to date: those of every section, and of every feature where there are few."""
    each_feature = len(unit.section_ids) <= FEATURES_SECTIONS_COUNT
    for section_id in unit.section_ids:
        report = unit.current_drift(section_id)
        if report is None or isinstance(report, Rejected):
            continue
        told = (*report.features, report.estimate) if report.estimate is not None else ()
        for feature in told if each_feature else ():
            metrics.drift_psi.labels(section_id, feature.name).set(feature.psi_ratio)
            metrics.drift_ks.labels(section_id, feature.name).set(feature.ks_frac)
        moved_frac = report.own_drifted_count / len(report.own_features) if report.own_features else nan
        metrics.drift_moved.labels(section_id).set(moved_frac)
        metrics.drift_outside.labels(section_id).set(report.out_of_envelope_frac)
        for alarm in DriftAlarm:
            metrics.drift_alarm.labels(section_id, alarm.value).set(alarm in report.alarms)


def show_rollout(status: RolloutStatus, *, unit: RoadSideUnit, metrics: Metrics) -> None:
    """Bring the gauges of the rollout up to date."""
    metrics.bundle.clear()
    manifest, shadow = unit.model_manifest, unit.shadow
    if manifest is not None:
        metrics.bundle.labels("live", manifest.bundle_id).set(1)
    for role, bundle in (("previous", status.state.previous), ("candidate", status.state.candidate)):
        if bundle is not None:
            metrics.bundle.labels(role, bundle.bundle_id).set(1)
    for stage in Stage:
        metrics.rollout_stage.labels(stage.value).set(stage is status.state.stage)
    found = None if shadow is None else status.comparison
    metrics.shadow_passages.set(0 if found is None else found.passages_count)
    metrics.shadow_failures.set(0 if found is None else found.failures_count)
    # A gauge without a value is NaN: zero would be perfect agreement.
    metrics.shadow_median.set(nan if found is None or found.median_ratio is None else found.median_ratio)
    metrics.shadow_spread.set(nan if found is None or found.spread_ratio is None else found.spread_ratio)


def rollout_of(
    settings: Settings,
    *,
    unit: RoadSideUnit,
    store: PassageStore,
    shelf: BundleShelf,
    started: Boot,
    clock: Clock,
    metrics: Metrics,
) -> Rollout:
    """Return what takes releases up for a unit.

    Args:
        settings: What an operator chose.
        unit: Runs what `started` holds.
        store: Keeps the ledger.
        shelf: Where `started` came from.
        started: What the unit started with.
        clock: Both clocks.
        metrics: Where refusals are counted.
    """
    updates = settings.updates

    def on_refusal(refusal: UpdateRefusal) -> None:
        metrics.update_refusals.labels(refusal.reason.value).inc()
        _log.error("update_refused", reason=refusal.reason.value, detail=refusal.detail)

    return Rollout(
        unit=unit,
        store=store,
        shelf=shelf,
        loading=loading_of(settings, metrics=metrics),
        source=source_of(settings, updates.source, clock=clock),
        ring=updates.ring,
        policy=ShadowPolicy(
            shadow_count=updates.shadow_count,
            probation_count=updates.probation_count,
            judged_from_count=updates.judged_from_count,
            median_limit_ratio=updates.median_limit_ratio,
            spread_limit_ratio=updates.spread_limit_ratio,
            share_limit_frac=updates.share_limit_frac,
            latency_limit_s=updates.latency_limit_s,
            failures_limit_count=updates.failures_limit_count,
        ),
        clock=clock,
        started=started,
        on_refusal=on_refusal,
    )
