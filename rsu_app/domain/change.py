"""Friction that changes within the hour: black ice must not wait until half of the window has driven over it.

Two cumulative sums watch the estimates in the order in which the vehicles left the section. One adds up by how much
estimates fall short of what vehicles before found, the other by how much they exceed it; each forgets itself at zero.
When one passes its threshold, the road is held to have changed where that sum last began, and the window is cut there.

A drop is believed after some six vehicles. A rise needs twice the evidence: being late with it costs speed, being
wrong with it costs grip.

What the detector says is a function of the entries alone, in the order of their times. So late reports and restored
windows need no thought: the fold is done again over what is held. It forgets with them, too: once no vehicle from
before a change is left, there is no change to be seen, and nothing to cut.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf

import numpy as np

from roadgrip.units import FloatArray
from rsu_app.domain.interval import median_of_ordered


class ChangeKind(StrEnum):
    """Which way the friction went."""

    DROP = "drop"
    RISE = "rise"


@dataclass(frozen=True, slots=True)
class ChangePolicy:
    """When the road is held to have changed. All amounts are of ln mu, hence ratios.

    Attributes:
        clip_ratio: No single vehicle adds more than its deviation up to this; so one absurd value proves nothing.
        slack_ratio: What every deviation is lessened by; above the half width of what wear alone spreads.
        drop_threshold_ratio: Sum at which a drop is believed.
        rise_threshold_ratio: Sum at which a rise is believed.
        reference_count: Vehicles whose median is what was found before.
        reference_from_count: Fewer than this tell of nothing before.
        lag_count: Newest vehicles that the reference leaves out, lest a change hide itself.
        kept_count: The newest vehicles that are kept whatever the change: fewer would leave the unit without an
            interval, just when the road is at its worst.
        watched_count: Vehicles that are looked at, the newest; bounds the work on a full window.
    """

    clip_ratio: float = 0.2
    slack_ratio: float = 0.11
    drop_threshold_ratio: float = 0.5
    rise_threshold_ratio: float = 1.0
    reference_count: int = 30
    reference_from_count: int = 6
    lag_count: int = 8
    kept_count: int = 10
    watched_count: int = 1_000

    def __post_init__(self) -> None:
        if not 0.0 < self.slack_ratio < self.clip_ratio:
            raise ValueError("a slack must lie above zero and below the clip, or nothing ever adds up")
        if not 0.0 < self.drop_threshold_ratio <= self.rise_threshold_ratio:
            raise ValueError("a rise is never believed sooner than a drop")
        if not 0 < self.reference_from_count <= self.reference_count:
            raise ValueError("a reference needs a vehicle, and no more than it may have")
        if min(self.lag_count, self.kept_count, self.watched_count) < 1:
            raise ValueError("counts are no less than one")


@dataclass(frozen=True, slots=True)
class Change:
    """A change of the road's friction.

    Attributes:
        kind: Which way.
        since_s: When the first vehicle that found the new friction left the section.
        seen_at_s: When the vehicle that proved it did.
        vehicles_count: How many found the new friction by then, the proving one included.
    """

    kind: ChangeKind
    since_s: float
    seen_at_s: float
    vehicles_count: int


@dataclass(frozen=True, slots=True)
class Evidence:
    """One cumulative sum: how much has added up, since when, over how many vehicles."""

    sum_ratio: float = 0.0
    since_s: float = inf
    vehicles_count: int = 0


@dataclass(frozen=True, slots=True)
class ChangeState:
    """All the detector remembers.

    Attributes:
        recent_log_mu: ln mu of the newest vehicles, oldest first; as many as lag and reference need.
        drop: What speaks for a drop.
        rise: What speaks for a rise.
    """

    recent_log_mu: tuple[float, ...] = ()
    drop: Evidence = Evidence()
    rise: Evidence = Evidence()


def observe(
    state: ChangeState, *, log_mu: float, at_s: float, policy: ChangePolicy
) -> tuple[ChangeState, Change | None]:
    """Return the state after one more vehicle, and the change that it proves, if any.

    With r the median of the vehicles before the newest few, c the clip and k the slack,
    `S = max(0, S + max(-c, min(c, r - ln mu)) - k)` for a drop and the mirror image for a rise. After a change
    everything begins anew with the vehicles since the change.

    Args:
        state: After the vehicles before.
        log_mu: ln of the estimate.
        at_s: When the vehicle left the section, no earlier than the one before.
        policy: When the road is held to have changed.

    References:
        Page, Continuous inspection schemes, Biometrika 41 (1954) 100-115; the clip is that of a robust score.
    """
    before = state.recent_log_mu[: max(0, len(state.recent_log_mu) - policy.lag_count)][-policy.reference_count :]
    recent = (*state.recent_log_mu, log_mu)[-policy.lag_count - policy.reference_count :]
    if len(before) < policy.reference_from_count:
        return replace(state, recent_log_mu=recent), None
    shortfall = median_of_ordered(sorted(before)) - log_mu
    drop = _added(state.drop, shortfall, at_s, policy)
    rise = _added(state.rise, -shortfall, at_s, policy)
    for kind, evidence, threshold in (
        (ChangeKind.DROP, drop, policy.drop_threshold_ratio),
        (ChangeKind.RISE, rise, policy.rise_threshold_ratio),
    ):
        if evidence.sum_ratio >= threshold:
            since = ChangeState(recent_log_mu=recent[-evidence.vehicles_count :])
            return since, Change(kind, evidence.since_s, at_s, evidence.vehicles_count)
    return ChangeState(recent, drop, rise), None


def changes(left_at_s: FloatArray, mu: FloatArray, *, policy: ChangePolicy) -> tuple[Change, ...]:
    """Return the changes that some entries tell of, in order; whatever the order of the entries.

    Args:
        left_at_s: When the vehicles left the section. (n,)
        mu: Their estimates; those that only say "at least" have no place here: they fall short of nothing. (n,)
        policy: When the road is held to have changed.
    """
    order = np.lexsort((mu, left_at_s))[-policy.watched_count :]
    state, found = ChangeState(), []
    for at_s, log_mu in zip(left_at_s[order].tolist(), np.log(mu[order]).tolist(), strict=True):
        state, change = observe(state, log_mu=log_mu, at_s=at_s, policy=policy)
        if change is not None:
            found.append(change)
    return tuple(found)


def mu_since_change(
    left_at_s: FloatArray, mu: FloatArray, *, policy: ChangePolicy, counted_from_s: float = -inf
) -> FloatArray:
    """Return the estimates that count when the window is cut at its latest change, ascending: all without a change.

    Made for `rsu_app.domain.interval.friction_interval`, where they take the place of the window's estimates; the
    newest vehicle is the same, so its age is too. The newest `kept_count` of the window stay in any case.

    Few vehicles an hour tell of no change within an hour. So the entries may go back farther than the window does:
    then the detector knows what was found before, and what is older than `counted_from_s` still does not count.

    Args:
        left_at_s: When the vehicles left the section. (n,)
        mu: Their estimates. (n,)
        policy: When the road is held to have changed.
        counted_from_s: When the window begins.
    """
    found = changes(left_at_s, mu, policy=policy)
    counted = left_at_s >= counted_from_s
    if found and counted.any():
        newest = np.sort(left_at_s[counted])[-policy.kept_count :]
        counted &= left_at_s >= min(found[-1].since_s, float(newest[0]))
    return np.sort(mu[counted])


def _added(evidence: Evidence, deviation: float, at_s: float, policy: ChangePolicy) -> Evidence:
    clipped_ratio = min(max(deviation, -policy.clip_ratio), policy.clip_ratio)
    sum_ratio = evidence.sum_ratio + clipped_ratio - policy.slack_ratio
    if sum_ratio <= 0.0:
        return Evidence()
    return Evidence(sum_ratio, min(evidence.since_s, at_s), evidence.vehicles_count + 1)
