"""What a unit says of a window of vehicles: the published interval, the refined one, the advice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.lying.judged import Judged
from roadgrip.section import RoadSection
from roadgrip.units import WINDOW_S, FloatArray, mps_to_kph
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.interval import IntervalPolicy, friction_interval, median_of_ordered
from rsu_app.domain.likelihoods import LikelihoodWindow
from rsu_app.domain.pooling import PoolingPolicy, refined_interval_of_window, support_of_window
from rsu_app.domain.probing import ProbingPolicy, Standing, WindowKnowledge, advise_as_known, marked_interval
from rsu_app.domain.watch import ChangeWatch
from rsu_app.domain.window import FrictionWindow, WindowRows

_INTERVAL, _POOLING, _ADVICE, _PROBING = IntervalPolicy(), PoolingPolicy(), AdvisoryPolicy(), ProbingPolicy()
_EACH_S = 60.0
"""A vehicle a minute: fifty are in the window at once."""


@dataclass(frozen=True, slots=True)
class Said:
    """What the unit says.

    Attributes:
        median_mu: The published midpoint.
        refined_mu: That of the refined interval.
        at_least: Whether that is a lower bound only, and what is published marked as such.
        advised_kph: The speed.
    """

    median_mu: float
    refined_mu: float
    at_least: bool
    advised_kph: float


def window_of(judged: Judged) -> FrictionWindow:
    """Return a window in which vehicles left one after the other, in the order given."""
    window = FrictionWindow(window_s=WINDOW_S)
    for i in range(len(judged)):
        window.add(
            left_at_s=_EACH_S * (i + 1),
            mu=float(judged.mu[i]),
            at_least=bool(judged.at_least[i]),
            mu_low=float(judged.mu_low[i]),
            expected_error_ratio=float(judged.expected_error_ratio[i]),
            slowest_mps=float(judged.slowest_mps[i]),
        )
    return window


def refined_midpoint_mu(judged: Judged) -> float:
    """Return the midpoint of the refined interval, whatever the order of the vehicles."""
    rows = WindowRows(
        left_at_s=_EACH_S * np.arange(1.0, len(judged) + 1.0),
        mu=judged.mu,
        at_least=judged.at_least,
        mu_low=judged.mu_low,
        expected_error_ratio=judged.expected_error_ratio,
        slowest_mps=judged.slowest_mps,
    )
    refined = refined_interval_of_window(rows, policy=_POOLING)
    assert refined is not None  # noqa: S101 - the window holds vehicles
    return 0.5 * (refined.mu_low + refined.mu_new)


def said(section: RoadSection, judged: Judged, *, standing_kph: float | None = None) -> Said:
    """Return what a unit says after these vehicles, the last of which left just now.

    Args:
        section: The road.
        judged: The vehicles, first to last.
        standing_kph: What drivers have been told for the last hour; None: nothing.
    """
    window = window_of(judged)
    now_s = window.newest_left_at_s
    interval = friction_interval(window.ordered_mu, newest_age_s=0.0, policy=_INTERVAL)
    refined = refined_interval_of_window(window.rows, policy=_POOLING)
    support = support_of_window(window.rows, policy=_POOLING)
    assert interval is not None  # noqa: S101 - the window holds vehicles
    assert refined is not None  # noqa: S101 - same
    assert support is not None  # noqa: S101 - same
    likelihoods = LikelihoodWindow(window_s=WINDOW_S)
    for i in np.flatnonzero(np.isfinite(judged.profile_ratio).all(axis=1)).tolist():
        likelihoods.add(left_at_s=_EACH_S * (i + 1), profile_ratio=judged.profile_ratio[i])
    advisory = advise_as_known(
        section,
        interval=marked_interval(interval, support),
        window=WindowKnowledge(window.rows, support, likelihoods.placed(now_s=now_s) if support.at_least else None),
        model_live=True,
        policy=_ADVICE,
        probing=_PROBING,
        standing=None if standing_kph is None else Standing(standing_kph / 3.6, now_s - WINDOW_S),
    )
    return Said(
        median_mu=interval.median_mu,
        refined_mu=0.5 * (refined.mu_low + refined.mu_new),
        at_least=support.at_least,
        advised_kph=mps_to_kph(advisory.speed_mps),
    )


def median_once_changed_mu(judged: Judged) -> float:
    """Return the published midpoint where the detector of changes is switched on; vehicles in the order given."""
    window, watch = window_of(judged), ChangeWatch(policy=ChangePolicy(), window_s=WINDOW_S)
    for i in np.flatnonzero(~judged.at_least).tolist():
        watch.add(left_at_s=_EACH_S * (i + 1), mu=float(judged.mu[i]))
    from_s = watch.counted_from_s(window, now_s=window.newest_left_at_s)
    left_at_s = _EACH_S * np.arange(1, len(judged) + 1)
    return median_of_ordered(np.sort(judged.mu[left_at_s >= from_s]).tolist())


def bounds_of_median_mu(honest_mu: FloatArray, *, liars_count: int) -> tuple[float, float]:
    """Return how low and how high the median can be if some of the vehicles say anything at all.

    Of n values k lie at either end; so it lies between the mean of the middle two of the honest ones with k zeros
    before them, and with k infinities behind them. Nothing that is said moves it further.

    Args:
        honest_mu: What the others say. (n - k,)
        liars_count: k, fewer than half.
    """
    ordered = np.sort(honest_mu).tolist()
    low = median_of_ordered([0.0] * liars_count + ordered)
    return low, median_of_ordered(ordered + [np.inf] * liars_count)
