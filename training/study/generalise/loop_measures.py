"""What a course of the closed loop comes to: errors once settled, how late, who left the road, who counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roadgrip.section import RoadSection
from roadgrip.units import WINDOW_S, BoolArray, FloatArray
from rsu_app.domain.advisory import AdvisoryPolicy, curve_speed_mps
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO, WORN_TYRE_RATIO
from training.closed_loop import Course

KNOWN_WITHIN_FRAC = 0.1
"""The unit knows the friction when what it publishes is no further off: the paper's worst case of fifty vehicles."""
HOLDS_FOR_S = 900.0
"""And it stays there for so long, lest a value in passing count."""
LOOK_EVERY_S = 60.0


@dataclass(frozen=True, slots=True)
class Phase:
    """A time of constant friction.

    Attributes:
        begin_s: When it begins.
        end_s: When it ends.
        base_friction_mu: What the road offers a new tyre.
    """

    begin_s: float
    end_s: float
    base_friction_mu: float

    def vehicles(self, course: Course) -> BoolArray:
        """Return which vehicles of a course came in this time. (n,)"""
        return (course.at_s >= self.begin_s) & (course.at_s < self.end_s)

    @property
    def looks_s(self) -> FloatArray:
        """Times at which one looks at what is published. (k,)"""
        return np.arange(self.begin_s, self.end_s, LOOK_EVERY_S)

    @property
    def settled_looks_s(self) -> FloatArray:
        """Those of them at which no vehicle of the time before counts any more. (k,)"""
        return self.looks_s[self.looks_s > self.begin_s + WINDOW_S]


def phases(frictions_mu: Sequence[float], *, phase_s: float) -> tuple[Phase, ...]:
    """Return times of the same length, one friction after the other."""
    return tuple(Phase(i * phase_s, (i + 1) * phase_s, mu) for i, mu in enumerate(frictions_mu))


@dataclass(frozen=True, slots=True)
class PhaseMeasures:
    """What a phase of a course comes to; NaN where there is nothing to measure.

    Attributes:
        error_frac: Magnitude of the error of the published middle, once settled, in the mean over time.
        bias_frac: The same with its sign.
        silent_frac: Share of the settled time in which nothing is published.
        marked_frac: Share of the published in which the unit marks it as hardly more than a lower bound.
        claimed_bias_frac: The bias at those times at which it does not.
        lag_s: Time from the phase's beginning until the published middle is right within `KNOWN_WITHIN_FRAC` and stays
            so for `HOLDS_FOR_S`; infinite if it never is.
        left_road_frac: Share of the vehicles that left the road.
        left_road_before_frac: The same of those that came before the unit knew.
        left_road_after_frac: The same of those that came later.
        counted_frac: Share of the summaries that count.
        followers_counted_frac: The same of drivers who followed the advice.
        named_frac: Share of the counted that name a friction instead of a bound.
        estimate_error_frac: Mean magnitude of a counted estimate's error against what its own tyres found.
        utilisation_ratio: Median over the vehicles of the largest share of the grip that each used.
        advised_ratio: Speed advised over what the truth would advise, once settled, in the mean over time.
    """

    error_frac: float
    bias_frac: float
    silent_frac: float
    marked_frac: float
    claimed_bias_frac: float
    lag_s: float
    left_road_frac: float
    left_road_before_frac: float
    left_road_after_frac: float
    counted_frac: float
    followers_counted_frac: float
    named_frac: float
    estimate_error_frac: float
    utilisation_ratio: float
    advised_ratio: float


def published_mu(course: Course, at_s: FloatArray) -> FloatArray:
    """Return the middle of the interval as it stands at some times, NaN without one. (k,)"""
    return MEDIAN_TYRE_RATIO * course.said_mu_new[_last_said(course, at_s)]


def advised_mps(course: Course, at_s: FloatArray) -> FloatArray:
    """Return the advised speed as it stands at some times. (k,)"""
    return course.advised_mps[_last_said(course, at_s)]


def right_speed_mps(section: RoadSection, *, base_friction_mu: float, policy: AdvisoryPolicy) -> float:
    """Return the curve speed for the lower end of the true interval, at most the limit, not rounded."""
    curve_mps = curve_speed_mps(
        section, mu=WORN_TYRE_RATIO * base_friction_mu, utilisation_frac=policy.utilisation_frac
    )
    return min(curve_mps, section.speed_limit_mps)


def lag_s(course: Course, phase: Phase) -> float:
    """Return how long after its beginning a phase's friction is known, infinity if it is not."""
    looks_s = phase.looks_s
    truth_mu = MEDIAN_TYRE_RATIO * phase.base_friction_mu
    known = np.abs(published_mu(course, looks_s) / truth_mu - 1.0) <= KNOWN_WITHIN_FRAC
    holds_count = round(HOLDS_FOR_S / LOOK_EVERY_S)
    for first in np.flatnonzero(known).tolist():
        if known[first : first + holds_count].all():
            return float(looks_s[first] - phase.begin_s)
    return np.inf


def phase_measures(course: Course, phase: Phase, *, section: RoadSection, policy: AdvisoryPolicy) -> PhaseMeasures:
    """Return what a phase of a course comes to.

    Args:
        course: The course.
        phase: The time.
        section: The road, for the speed that would be right.
        policy: How a unit advises there.
    """
    here = phase.vehicles(course)
    counted, followers = here & course.counted, here & course.follows & course.passed
    known_from_s = phase.begin_s + lag_s(course, phase)
    looks_s = phase.settled_looks_s
    ratio = published_mu(course, looks_s) / (MEDIAN_TYRE_RATIO * phase.base_friction_mu)
    right_mps = right_speed_mps(section, base_friction_mu=phase.base_friction_mu, policy=policy)
    said, marked = np.isfinite(ratio), course.said_at_least[_last_said(course, looks_s)]
    return PhaseMeasures(
        error_frac=_mean(np.abs(ratio[said] - 1.0)),
        bias_frac=_mean(ratio[said] - 1.0),
        silent_frac=_mean(~said),
        marked_frac=_mean(marked[said]),
        claimed_bias_frac=_mean(ratio[said & ~marked] - 1.0),
        lag_s=known_from_s - phase.begin_s,
        left_road_frac=_mean(~course.kept_to_road[here]),
        left_road_before_frac=_mean(~course.kept_to_road[here & (course.at_s < known_from_s)]),
        left_road_after_frac=_mean(~course.kept_to_road[here & (course.at_s >= known_from_s)]),
        counted_frac=_mean(counted[here & course.passed]),
        followers_counted_frac=_mean(counted[followers]),
        named_frac=_mean(~course.at_least[counted]),
        estimate_error_frac=_mean(np.abs(course.mu[counted] / course.label_mu[counted] - 1.0)),
        utilisation_ratio=float(np.median(course.peak_utilisation_ratio[here])) if here.any() else np.nan,
        advised_ratio=_mean(advised_mps(course, looks_s) / right_mps),
    )


@dataclass(frozen=True, slots=True)
class Drift:
    """What a wrong advice does to a unit, once settled; NaN where there is nothing to compare.

    Attributes:
        claimed_frac: By how much it moves the middle that is published, at times at which both courses have one that is
            not marked as a lower bound.
        advised_frac: By how much it moves the speed that the unit means to advise.
    """

    claimed_frac: float
    advised_frac: float


def drift(wrong: Course, right: Course, phase: Phase) -> Drift:
    """Return what a wrong advice does.

    Args:
        wrong: Drivers were told another speed than the unit meant.
        right: The same vehicles, told what the unit meant.
        phase: The time.
    """
    looks_s = phase.settled_looks_s
    wrong_mu, right_mu = (published_mu(course, looks_s) for course in (wrong, right))
    wrong_marked, right_marked = (course.said_at_least[_last_said(course, looks_s)] for course in (wrong, right))
    both = np.isfinite(wrong_mu) & np.isfinite(right_mu) & ~wrong_marked & ~right_marked
    return Drift(
        claimed_frac=_mean(wrong_mu[both]) / _mean(right_mu[both]) - 1.0,
        advised_frac=_mean(advised_mps(wrong, looks_s)) / _mean(advised_mps(right, looks_s)) - 1.0,
    )


def farthest(values: Sequence[float]) -> float:
    """Return the value that lies farthest from zero, NaN if there is none."""
    known = [value for value in values if np.isfinite(value)]
    return max(known, key=abs) if known else np.nan


def largest(values: Sequence[float]) -> float:
    """Return the largest value, NaN if there is none."""
    known = [value for value in values if np.isfinite(value)]
    return max(known) if known else np.nan


def _last_said(course: Course, at_s: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.maximum(np.searchsorted(course.said_at_s, at_s, side="right") - 1, 0)


def _mean(values: FloatArray | BoolArray) -> float:
    return float(np.mean(values)) if len(values) else np.nan
