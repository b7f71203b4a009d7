"""What the unit says of a section's friction: the published interval, and beside it the refined one.

What is published is an index away in a window that is always in order. Everything else, how far vehicles support it
included, looks at the newest of them only, a number that no traffic exceeds, and is computed once after each change of
the window, when somebody asks.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import inf

import numpy as np

from roadgrip.records import Advisory, FrictionInterval
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.interval import IntervalPolicy, friction_interval
from rsu_app.domain.pooling import PoolingPolicy, RefinedInterval, refined_interval_of_window, support_of_window
from rsu_app.domain.probing import ProbingPolicy, WindowKnowledge, advise_as_known, marked_interval, standing_after
from rsu_app.domain.window import WindowRows
from rsu_app.usecases.section_state import SectionState, WindowReading

NEWEST_COUNT = 1_000
"""Vehicles the refined interval looks at, and the published one behind a change: with so many, more make no difference
that an error all vehicles share would not swamp."""


@dataclass(frozen=True, slots=True)
class FrictionPolicies:
    """What is asked of the vehicles of a section before its friction is said, and before advice follows.

    Attributes:
        interval: Of the published interval.
        pooling: What the refined one assumes, and when the published one is supported.
        probing: What is asked before the advice rises while it is not.
        change: When the road is held to have changed, so that older estimates no longer count; None never.
    """

    interval: IntervalPolicy = field(default_factory=IntervalPolicy)
    pooling: PoolingPolicy = field(default_factory=PoolingPolicy)
    probing: ProbingPolicy = field(default_factory=ProbingPolicy)
    change: ChangePolicy | None = None


@dataclass(frozen=True, slots=True)
class SectionFriction:
    """The friction of a section as of now.

    Attributes:
        interval: What is published.
        refined: The second opinion: each estimate with its expected error, bounds as bounds.
        since_change_s: The window was cut at a change of the friction so long ago; None without one.
    """

    interval: FrictionInterval
    refined: RefinedInterval
    since_change_s: float | None

    @property
    def at_least(self) -> bool:
        """Whether so few vehicles name a friction that what is published is not much more than a lower bound."""
        return self.refined.at_least


@dataclass(frozen=True, slots=True)
class Knowledge:
    """What the vehicles of a section know as of now.

    Attributes:
        interval: What is published; provisional at best where too few vehicles name a friction.
        reading: The vehicles, and how far they know the friction.
    """

    interval: FrictionInterval
    reading: WindowReading


def knowledge(state: SectionState, *, now_s: float, policies: FrictionPolicies) -> Knowledge | None:
    """Return what the vehicles of a section know as of now, None without any.

    Args:
        state: Of the section.
        now_s: By the monotonic clock.
        policies: What is asked of them.
    """
    state.window.evict(now_s=now_s)
    counted_from_s = _counted_from_s(state, now_s=now_s)
    interval = _published(state, now_s=now_s, policy=policies.interval, counted_from_s=counted_from_s)
    if interval is None:
        return None
    newest = state.window.newest_rows(NEWEST_COUNT)
    reading = state.reading
    if reading is None or reading.newest is not newest or reading.counted_from_s != counted_from_s:
        rows = _since(newest, counted_from_s)
        support = support_of_window(rows, policy=policies.pooling)
        assert support is not None  # noqa: S101 - the window holds a vehicle, or there were no interval
        reading = state.reading = WindowReading(newest, counted_from_s, rows, support)
    return Knowledge(marked_interval(interval, reading.support), reading)


def published_interval(state: SectionState, *, now_s: float, policies: FrictionPolicies) -> FrictionInterval | None:
    """Return the friction interval of a section as of now, None if no vehicle is behind it."""
    known = knowledge(state, now_s=now_s, policies=policies)
    return None if known is None else known.interval


def section_friction(state: SectionState, *, now_s: float, policies: FrictionPolicies) -> SectionFriction | None:
    """Return everything that is known of a section's friction as of now, None if no vehicle is behind it.

    Args:
        state: Of the section.
        now_s: By the monotonic clock.
        policies: What is asked of the vehicles.
    """
    known = knowledge(state, now_s=now_s, policies=policies)
    if known is None:
        return None
    reading = known.reading
    refined = reading.refined or refined_interval_of_window(reading.rows, policy=policies.pooling)
    assert refined is not None  # noqa: S101 - the window holds a vehicle, or nothing were known
    reading.refined = refined
    counted_from_s = reading.counted_from_s
    return SectionFriction(
        interval=known.interval,
        refined=refined,
        since_change_s=None if counted_from_s == -inf else max(0.0, now_s - counted_from_s),
    )


def section_advisory(
    state: SectionState,
    *,
    now_s: float,
    model_live: bool,
    policies: FrictionPolicies,
) -> Advisory:
    """Return what drivers on a section are told as of now, and remember it.

    Args:
        state: Of the section.
        now_s: By the monotonic clock.
        model_live: Whether the unit has a model.
        policies: What is asked of the vehicles.
    """
    known = knowledge(state, now_s=now_s, policies=policies)
    advisory = advise_as_known(
        state.section,
        interval=None if known is None else known.interval,
        window=None if known is None else _window_knowledge(state, known.reading, now_s=now_s),
        model_live=model_live,
        policy=state.policy,
        probing=policies.probing,
        standing=state.standing,
    )
    state.standing = standing_after(state.standing, advisory, now_s=now_s)
    state.advisory = advisory
    return advisory


def _window_knowledge(state: SectionState, reading: WindowReading, *, now_s: float) -> WindowKnowledge:
    # The likelihoods are only asked where few vehicles name a friction.
    likely = None
    if reading.support.at_least:
        likely = state.likelihoods.placed(now_s=now_s, counted_from_s=reading.counted_from_s)
    return WindowKnowledge(rows=reading.rows, support=reading.support, likely=likely)


def _published(
    state: SectionState, *, now_s: float, policy: IntervalPolicy, counted_from_s: float
) -> FrictionInterval | None:
    if counted_from_s == -inf:
        ordered_mu = state.window.ordered_mu
    else:
        ordered_mu = np.sort(_since(state.window.newest_rows(NEWEST_COUNT), counted_from_s).mu).tolist()
    newest_age_s = max(0.0, now_s - state.window.newest_left_at_s)
    return friction_interval(ordered_mu, newest_age_s=newest_age_s, policy=policy)


def _counted_from_s(state: SectionState, *, now_s: float) -> float:
    return -inf if state.watch is None else state.watch.counted_from_s(state.window, now_s=now_s)


def _since(rows: WindowRows, counted_from_s: float) -> WindowRows:
    first = int(np.searchsorted(rows.left_at_s, counted_from_s))
    return rows if first == 0 else WindowRows(*(getattr(rows, column.name)[first:] for column in fields(rows)))
