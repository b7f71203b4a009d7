"""What the unit holds for each section, and how a passage over it is judged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from roadgrip.errors import BundleError, ConfigurationError
from roadgrip.features import TABLES, FeatureTable, road_features
from roadgrip.records import Advisory, NotCounted
from roadgrip.section import RoadSection
from roadgrip.units import FloatArray
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.judgement import Judgement, judgements
from rsu_app.domain.likelihoods import LikelihoodWindow
from rsu_app.domain.pooling import RefinedInterval, Support
from rsu_app.domain.probing import Standing
from rsu_app.domain.watch import ChangeWatch
from rsu_app.domain.window import FrictionWindow, WindowRows
from rsu_app.ports import CountablePassage, FrictionModel
from rsu_app.usecases.changes import Subscription
from rsu_app.usecases.drift_watch import DriftWatch


@dataclass(slots=True)
class WindowReading:
    """What the vehicles of a window know, read from it once after each of its changes.

    Attributes:
        newest: The window's newest entries; another object once the window has changed.
        counted_from_s: From when on they counted.
        rows: Those that count.
        support: How far they know the friction.
        refined: What they place together; None until somebody asks.
    """

    newest: WindowRows
    counted_from_s: float
    rows: WindowRows
    support: Support
    refined: RefinedInterval | None = None


@dataclass(slots=True)
class SectionState:
    """Everything that is known of a section right now.

    Attributes:
        section: Its map.
        policy: What the road authority decides about its advice.
        road_rows: The features that follow from the map, by the digest of the feature table.
        window: The estimates of the last hour.
        likelihoods: What their passages say about every friction.
        listeners: Who is told of changes.
        watch: Looks for changes of the friction; None where that is not wanted.
        advisory: What drivers were told last; None before the first time.
        standing: The speed in it and since when it is told.
        reading: What the vehicles knew when it was asked for last.
        drift: Looks whether traffic is still what the live model was made for.
    """

    section: RoadSection
    policy: AdvisoryPolicy
    road_rows: Mapping[str, FloatArray]
    window: FrictionWindow
    likelihoods: LikelihoodWindow
    listeners: set[Subscription]
    drift: DriftWatch
    watch: ChangeWatch | None = None
    advisory: Advisory | None = None
    standing: Standing | None = None
    reading: WindowReading | None = None


def section_states(
    sections: Iterable[RoadSection],
    *,
    policy: AdvisoryPolicy,
    section_policies: Mapping[str, AdvisoryPolicy],
    window_s: float,
    window_capacity_count: int,
    change_policy: ChangePolicy | None = None,
) -> dict[str, SectionState]:
    """Return a fresh state for each section, by its id.

    Args:
        sections: The maps, at least one.
        policy: For every section without one of its own.
        section_policies: By section id.
        window_s: How long an estimate counts.
        window_capacity_count: Estimates per section that are counted at once.
        change_policy: When a road is held to have changed; None does not look for it.

    Raises:
        ConfigurationError: The sections or policies contradict themselves.
    """
    states: dict[str, SectionState] = {}
    for section in sections:
        if section.section_id in states:
            raise ConfigurationError(f"section {section.section_id} is given twice")
        states[section.section_id] = SectionState(
            section=section,
            policy=section_policies.get(section.section_id, policy),
            road_rows=_road_rows(section),
            window=FrictionWindow(window_s=window_s, capacity_count=window_capacity_count),
            likelihoods=LikelihoodWindow(window_s=window_s),
            listeners=set(),
            drift=DriftWatch(section.section_id),
            watch=None if change_policy is None else ChangeWatch(policy=change_policy, window_s=window_s),
        )
    if not states:
        raise ConfigurationError("a unit without a section has nothing to do")
    if unknown := set(section_policies) - set(states):
        raise ConfigurationError(f"policies for sections that are not served: {', '.join(sorted(unknown))}")
    return states


def _road_rows(section: RoadSection) -> dict[str, FloatArray]:
    # Once per map: the road's features never change while it stays the same.
    rows = {digest: road_features(section, table) for digest, table in TABLES.items()}
    for digest, table in TABLES.items():
        for feature, value in zip(table.road, rows[digest], strict=True):
            if not feature.minimum <= value <= feature.maximum:
                raise ConfigurationError(f"section {section.section_id}: {feature.name} = {value:.6g} is out of range")
    return rows


def count_passage(state: SectionState, passage: CountablePassage, *, left_at_s: float, age_s: float) -> bool:
    """Let a passage count for a section, and return whether it does; one that is too old or flagged does not.

    A passage from before a restart counts as any other.

    Args:
        state: Of the section it names.
        passage: What is stored of it.
        left_at_s: When the vehicle left the section, by the monotonic clock.
        age_s: How long ago that is, by the clock that knows.
    """
    estimate, window_s = passage.estimate, state.window.window_s
    memory_s = window_s if state.watch is None else state.watch.memory_s
    if not 0.0 <= age_s <= memory_s or estimate.mu is None or estimate.flags is not NotCounted.NONE:
        return False
    if state.watch is not None and not estimate.at_least:
        state.watch.add(left_at_s=left_at_s, mu=estimate.mu)
    if age_s > window_s:
        return False
    state.window.add(
        left_at_s=left_at_s,
        mu=estimate.mu,
        at_least=estimate.at_least,
        mu_low=nan if estimate.mu_low is None else estimate.mu_low,
        expected_error_ratio=nan if estimate.expected_error_ratio is None else estimate.expected_error_ratio,
        slowest_mps=_slowest_mps(passage),
    )
    profile_ratio = _profile_ratio(passage)
    if profile_ratio is not None:
        state.likelihoods.add(left_at_s=left_at_s, profile_ratio=profile_ratio)
    return True


def _slowest_mps(passage: CountablePassage) -> float:
    """Return how slowly a vehicle drove where it was slowest, NaN with a table that nobody knows any more."""
    place = _SLOWEST_PLACES.get(passage.table_digest)
    return nan if place is None else float(passage.values[place])


_SLOWEST_PLACES = {digest: table.index("speed_min_mps") for digest, table in TABLES.items()}


def _profile_ratio(passage: CountablePassage) -> FloatArray | None:
    """Return the log likelihood of friction that a vehicle sent, None with a table that has none. (k,)"""
    places = _PROFILE_PLACES.get(passage.table_digest)
    return passage.values[places].astype(np.float64) if places is not None else None


def _profile_places(table: FeatureTable) -> slice | None:
    """Return where a table holds the log likelihood, in one piece; None if it does not."""
    places = [place for place, name in enumerate(table.names) if name.startswith("grip_profile_")]
    if places and places != list(range(places[0], places[-1] + 1)):
        raise ConfigurationError(f"feature table {table.digest} scatters its likelihood")
    return slice(places[0], places[-1] + 1) if places else None


_PROFILE_PLACES = {digest: _profile_places(table) for digest, table in TABLES.items()}


def judged_values(
    table_digest: str, values: NDArray[np.float32], states: Sequence[SectionState], model: FrictionModel
) -> list[Judgement]:
    """Return what the bundle's model for the summaries' own feature table says; never that for another one.

    A model of the bundle for a single section comes before the global one. Many passages at once cost a model a
    fraction of what they cost one by one.

    Args:
        table_digest: Of the summaries.
        values: Of passages that can have happened, at least one. (n, k)
        states: Of the section of each; the bundle has the same model for all of them.
        model: The live models.

    Raises:
        BundleError: There is no model for that table, or it does not answer.
    """
    section_id = states[0].section.section_id
    manifest = model.manifest.model_for(table_digest, section_id=section_id)
    if manifest is None:
        raise BundleError(f"bundle {model.manifest.bundle_id} has no model for feature table {table_digest}")
    rows = np.hstack([values.astype(np.float64), np.stack([state.road_rows[table_digest] for state in states])])
    answer = model.estimate(table_digest, rows, section_id=section_id)
    errors = answer.expected_error_ratio
    return judgements(
        rows, manifest, mu=answer.mu.tolist(), expected_error_ratio=None if errors is None else errors.tolist()
    )
