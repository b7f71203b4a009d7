"""What the unit says of a section's friction: the published interval, and beside it the refined one.

What is published is an index away in a window that is always in order. Everything else looks at the newest vehicles
only, a number that no traffic exceeds, and is computed once after each change of the window, when somebody asks.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import inf

import numpy as np

from roadgrip.records import FrictionInterval
from rsu_app.domain.interval import IntervalPolicy, friction_interval
from rsu_app.domain.pooling import PoolingPolicy, RefinedInterval, refined_interval_of_window
from rsu_app.domain.window import WindowRows
from rsu_app.usecases.section_state import RememberedRefined, SectionState

NEWEST_COUNT = 1_000
"""Vehicles the refined interval looks at, and the published one behind a change: with so many, more make no difference
that an error all vehicles share would not swamp."""


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


def published_interval(state: SectionState, *, now_s: float, policy: IntervalPolicy) -> FrictionInterval | None:
    """Return the friction interval of a section as of now, None if no vehicle is behind it."""
    state.window.evict(now_s=now_s)
    return _published(state, now_s=now_s, policy=policy, counted_from_s=_counted_from_s(state, now_s=now_s))


def section_friction(
    state: SectionState, *, now_s: float, policy: IntervalPolicy, pooling_policy: PoolingPolicy
) -> SectionFriction | None:
    """Return everything that is known of a section's friction as of now, None if no vehicle is behind it.

    Args:
        state: Of the section.
        now_s: By the monotonic clock.
        policy: Of the published interval.
        pooling_policy: Of the refined one.
    """
    state.window.evict(now_s=now_s)
    counted_from_s = _counted_from_s(state, now_s=now_s)
    interval = _published(state, now_s=now_s, policy=policy, counted_from_s=counted_from_s)
    if interval is None:
        return None
    newest = state.window.newest_rows(NEWEST_COUNT)
    if state.refined is None or state.refined.rows is not newest or state.refined.counted_from_s != counted_from_s:
        refined = refined_interval_of_window(_since(newest, counted_from_s), policy=pooling_policy)
        assert refined is not None  # noqa: S101 - the window holds a vehicle, or there were no interval
        state.refined = RememberedRefined(newest, counted_from_s, refined)
    return SectionFriction(
        interval=interval,
        refined=state.refined.interval,
        since_change_s=None if counted_from_s == -inf else max(0.0, now_s - counted_from_s),
    )


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
