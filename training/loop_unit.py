"""A road side unit without store, clock or radio: the rules it applies, for vehicles that the laboratory drives."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from math import isfinite, nan

import numpy as np

from roadgrip.features import PROFILE_FRICTIONS_MU
from roadgrip.records import Advisory, FrictionInterval, NotCounted
from roadgrip.section import RoadSection
from roadgrip.units import WINDOW_S, FloatArray
from rsu_app.domain.advisory import AdvisoryPolicy, advise
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO, IntervalPolicy, friction_interval
from rsu_app.domain.judgement import Judgement
from rsu_app.domain.pooling import (
    PoolingPolicy,
    RefinedInterval,
    refined_interval_of_window,
    support_of_window,
)
from rsu_app.domain.probing import ProbingPolicy, Standing, WindowKnowledge, advise_as_known, standing_after
from rsu_app.domain.profiles import ProfilePolicy, pooled_profile
from rsu_app.domain.watch import ChangeWatch
from rsu_app.domain.window import FrictionWindow, WindowRows


@dataclass(frozen=True, slots=True)
class UnitRules:
    """What is decided about a unit.

    Attributes:
        interval: About intervals.
        advisory: About advice.
        change: When the road is held to have changed; None: it waits until the hour has passed.
        pooling: How the interval comes about that advice rests on: by estimates with their errors and bounds, or by
            the sum of all likelihoods of friction; where it is a lower bound only, advice rests on that. None: by the
            median, to which a bound is an estimate.
        probing: How advice comes about while the friction is not known; None: as if it were.
    """

    interval: IntervalPolicy = field(default_factory=IntervalPolicy)
    advisory: AdvisoryPolicy = field(default_factory=AdvisoryPolicy)
    change: ChangePolicy | None = None
    pooling: PoolingPolicy | ProfilePolicy | None = None
    probing: ProbingPolicy | None = None


class LoopUnit:
    """The unit of one section.

    Args:
        section: The road.
        rules: What is decided.
    """

    def __init__(self, section: RoadSection, rules: UnitRules) -> None:
        self._section = section
        self._rules = rules
        self._window = FrictionWindow(window_s=WINDOW_S)
        self._watch = None if rules.change is None else ChangeWatch(policy=rules.change, window_s=WINDOW_S)
        self._profiles: list[tuple[float, FloatArray]] = []
        self._standing: Standing | None = None
        self._rows = self._window.rows
        self._bound: RefinedInterval | None = None
        self.at_least = False
        """Whether what was said last is marked as hardly more than a lower bound."""

    def hear(self, judged: Judgement, *, left_at_s: float, profile_ratio: FloatArray, slowest_mps: float = nan) -> bool:
        """Return whether a passage counts; from now on, if it does.

        Args:
            judged: What it says.
            left_at_s: When the vehicle left the section.
            profile_ratio: Its log likelihood at `roadgrip.features.PROFILE_FRICTIONS_MU`. (k,)
            slowest_mps: How slowly it drove where it was slowest.
        """
        if judged.mu is None or judged.flags != NotCounted.NONE:
            return False
        self._window.add(
            left_at_s=left_at_s,
            mu=judged.mu,
            at_least=judged.at_least,
            mu_low=nan if judged.mu_low is None else judged.mu_low,
            expected_error_ratio=nan if judged.expected_error_ratio is None else judged.expected_error_ratio,
            slowest_mps=slowest_mps,
        )
        self._profiles.append((left_at_s, profile_ratio))
        if self._watch is not None and not judged.at_least:
            self._watch.add(left_at_s=left_at_s, mu=judged.mu)
        return True

    def interval(self, *, now_s: float) -> FrictionInterval | None:
        """Return the interval that advice rests on, None without a vehicle."""
        self._window.evict(now_s=now_s)
        from_s = now_s - self._window.window_s
        if self._watch is not None:
            from_s = max(from_s, self._watch.counted_from_s(self._window, now_s=now_s))
        rows = _since(self._window.rows, from_s)
        interval = friction_interval(
            np.sort(rows.mu).tolist(),
            newest_age_s=max(0.0, now_s - self._window.newest_left_at_s),
            policy=self._rules.interval,
        )
        if interval is None:
            return None
        refined = self._refined(rows, from_s=from_s)
        self._rows, self._bound = rows, refined
        self._profiles = [told for told in self._profiles if told[0] >= from_s]
        self.at_least = refined is not None and refined.at_least
        return interval if refined is None or self._rules.pooling is None else _replaced(interval, refined)

    def _refined(self, rows: WindowRows, *, from_s: float) -> RefinedInterval | None:
        policy = self._rules.pooling or PoolingPolicy()
        if isinstance(policy, PoolingPolicy):
            return refined_interval_of_window(rows, policy=policy)
        return _pooled([profile for at_s, profile in self._profiles if at_s >= from_s], policy)

    def advise(self, *, now_s: float) -> Advisory:
        """Return what drivers are told now."""
        interval = self.interval(now_s=now_s)
        if self._rules.probing is None:
            advisory = advise(
                self._section,
                interval=interval,
                model_live=True,
                policy=self._rules.advisory,
                previous_speed_mps=None if self._standing is None else self._standing.speed_mps,
            )
        else:
            advisory = advise_as_known(
                self._section,
                interval=interval,
                window=None if interval is None else self._knowledge(),
                model_live=True,
                policy=self._rules.advisory,
                probing=self._rules.probing,
                standing=self._standing,
            )
        self._standing = standing_after(self._standing, advisory, now_s=now_s)
        return advisory

    def _knowledge(self) -> WindowKnowledge | None:
        """Return what the vehicles know; where advice rests on likelihoods, they know it as far as those place it."""
        pooling = self._rules.pooling
        known = support_of_window(self._rows, policy=pooling if isinstance(pooling, PoolingPolicy) else PoolingPolicy())
        if known is None:
            return None
        profiles = [profile for _, profile in self._profiles]
        likely = self._bound if isinstance(pooling, ProfilePolicy) else _pooled(profiles, ProfilePolicy())
        if isinstance(pooling, ProfilePolicy) and likely is not None:
            known = replace(known, at_least=likely.at_least)
        return WindowKnowledge(rows=self._rows, support=known, likely=likely)


def _pooled(profiles: list[FloatArray], policy: ProfilePolicy) -> RefinedInterval | None:
    return pooled_profile(np.array(profiles), grid_mu=np.array(PROFILE_FRICTIONS_MU), policy=policy)


def _replaced(interval: FrictionInterval, refined: RefinedInterval) -> FrictionInterval:
    """Return an interval that stands where a refined one does, for advice that takes it for the published one.

    The half-width reaches the farther end, which is the upper one where little is known; so the lower end is taken to
    be as far away in its logarithm, not in friction. A lower bound is its own lower end.
    """
    reach_mu = refined.half_width_mu if isfinite(refined.half_width_mu) else 0.0
    sure_mu = refined.mu_new**2 / (refined.mu_new + reach_mu)
    return replace(interval, mu_low=refined.mu_low, mu_new=refined.mu_new, median_low_mu=MEDIAN_TYRE_RATIO * sure_mu)


def _since(rows: WindowRows, from_s: float) -> WindowRows:
    first = int(np.searchsorted(rows.left_at_s, from_s))
    return WindowRows(**{field.name: getattr(rows, field.name)[first:] for field in fields(rows)})
