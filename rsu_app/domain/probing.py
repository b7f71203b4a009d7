"""What is advised while nobody knows the friction: drivers who obey may be too slow to feel it.

Who drives as slowly as he is told uses little of the grip, and then hardly tells how much there is: his passage is a
lower bound. If such bounds lowered the advice, the next drivers would be slower still and know even less; a slow advice
would prove itself, and so would a wrong one. If they raised it as estimates do, ice would be found by accident.

So while too few vehicles name a friction, the advice that stands is held. It rises step by step, as an experiment, and
only where vehicles have shown that there is headroom: they drove as fast as they were told, and yet hardly any of them
felt the limit of the grip. As soon as some do, it rises no further; as soon as enough do, the friction is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor

import numpy as np

from roadgrip.records import Advisory, AdvisoryReason, Confidence, FrictionInterval
from roadgrip.section import RoadSection
from roadgrip.units import kph_to_mps, mps_to_kph
from rsu_app.domain.advisory import STEP_KPH, AdvisoryPolicy, advise, curve_speed_mps
from rsu_app.domain.interval import mu_low_of_median
from rsu_app.domain.likelihoods import LIKELIHOODS_COUNT
from rsu_app.domain.pooling import RefinedInterval, Support
from rsu_app.domain.window import WindowRows

_ROUNDING_KPH = 0.02
"""A section stores its limit in steps of 0.01 m/s: 80 km/h comes back as 79.99 and must stay 80."""
_BY_FRICTION = frozenset(
    {
        AdvisoryReason.FRICTION_INTERVAL,
        AdvisoryReason.LOWER_CONFIDENCE_BOUND,
        AdvisoryReason.WINTER_SPEED_WHILE_PROVISIONAL,
    }
)


@dataclass(frozen=True, slots=True)
class ProbingPolicy:
    """What is asked while the friction is not known.

    Attributes:
        evidence_count: Vehicles that must have driven by the advice that stands before it rises by a step.
        named_frac: It rises only while no larger share of those who heard it names a friction.
        driven_frac: Who drives nowhere slower than this share of the advised speed has driven by it; who is slower
            shows nothing about the advised speed.
        heard_after_s: Vehicles that leave later than this after an advice began have heard it.
        knowing_count: From so many vehicles on, those who name a friction bound the advice.
        likely_count: From so many on, the likelihoods of all do: that fewer agree by chance is too likely.
        sure_count: From so many vehicles on, a lower bound may raise the advice above the winter speed.
    """

    evidence_count: int = 10
    named_frac: float = 0.1
    driven_frac: float = 0.9
    heard_after_s: float = 300.0
    knowing_count: int = 6
    likely_count: int = 20
    sure_count: int = 50

    def __post_init__(self) -> None:
        if min(self.evidence_count, self.knowing_count, self.likely_count, self.sure_count) < 1:
            raise ValueError("no vehicle shows nothing")
        if not (0.0 <= self.named_frac < 1.0 and 0.0 < self.driven_frac <= 1.0):
            raise ValueError("shares of those who name a friction and of the advised speed lie between 0 and 1")
        if not self.heard_after_s >= 0.0:
            raise ValueError("nobody hears an advice before it is given")


@dataclass(frozen=True, slots=True)
class Standing:
    """What drivers are told.

    Attributes:
        speed_mps: The advice.
        since_s: Since when.
    """

    speed_mps: float
    since_s: float


@dataclass(frozen=True, slots=True)
class WindowKnowledge:
    """What the vehicles of a window know.

    Attributes:
        rows: Those that count, oldest first.
        support: How far they know the friction.
        likely: What the likelihoods of friction that they sent place together, if they sent some.
    """

    rows: WindowRows
    support: Support
    likely: RefinedInterval | None = None

    @property
    def likely_count(self) -> int:
        """How many vehicles sent their likelihoods."""
        return 0 if self.likely is None else self.likely.informative_count + self.likely.censored_count

    @property
    def is_watched(self) -> bool:
        """Whether ice would show: at least half of the newest vehicles sent their likelihoods."""
        return 2 * self.likely_count >= min(len(self.rows.mu), LIKELIHOODS_COUNT)


def standing_after(standing: Standing | None, advisory: Advisory, *, now_s: float) -> Standing:
    """Return what drivers are told once an advisory is given; its time goes on if it says what stood before."""
    if standing is not None and standing.speed_mps == advisory.speed_mps:
        return standing
    return Standing(advisory.speed_mps, now_s)


def marked_interval(interval: FrictionInterval, support: Support) -> FrictionInterval:
    """Return an interval that is provisional at best if too few vehicles name a friction, however many passed."""
    if support.at_least and interval.confidence is Confidence.RECOMMENDED:
        return replace(interval, confidence=Confidence.PROVISIONAL)
    return interval


def shows_headroom(rows: WindowRows, *, standing: Standing, policy: ProbingPolicy) -> bool:
    """Return whether vehicles have driven by the advice that stands and hardly any of them felt the limit of the grip.

    Args:
        rows: The vehicles that count.
        standing: The advice, and since when.
        policy: What is asked of them.
    """
    heard = rows.left_at_s > standing.since_s + policy.heard_after_s
    unfelt = heard & rows.at_least & (rows.slowest_mps >= policy.driven_frac * standing.speed_mps)
    felt_count = np.count_nonzero(heard & ~rows.at_least)
    enough = np.count_nonzero(unfelt) >= policy.evidence_count
    return bool(enough and felt_count <= policy.named_frac * np.count_nonzero(heard))


def advise_as_known(
    section: RoadSection,
    *,
    interval: FrictionInterval | None,
    window: WindowKnowledge | None,
    model_live: bool,
    policy: AdvisoryPolicy,
    probing: ProbingPolicy,
    standing: Standing | None,
) -> Advisory:
    """Return what drivers are told, whether the friction is known or not.

    By `rsu_app.domain.advisory.advise` where enough vehicles name a friction, or there is nothing to go by at all; only
    that those who know a bound do not lower it: it falls no further than the median says to which a bound is one.

    Otherwise the advice that stands is held, as long as vehicles send likelihoods, and

    - rises by a step, to the winter speed at most, once vehicles have shown headroom;
    - is no lower than a known friction of the bound's value would give;
    - is no higher than those give who name a friction, nor the likelihoods of all where they exclude a high one, if
      there are a few of either. They may know of ice where no single vehicle does, and may only lower the advice.

    Without an advice that stands it begins as with a provisional interval; without likelihoods it stays with that, for
    nothing else would tell of ice under drivers who are slower than they are told.

    Args:
        section: The map.
        interval: What is published.
        window: What the vehicles behind it know; None without any.
        model_live: Whether the unit has a model.
        policy: What the road authority decides.
        probing: What is asked while the friction is not known.
        standing: What drivers are told now; None before the first time.
    """
    plain = advise(
        section,
        interval=interval if interval is None or window is None else marked_interval(interval, window.support),
        model_live=model_live,
        policy=policy,
        previous_speed_mps=None if standing is None else standing.speed_mps,
    )
    if window is None or interval is None or plain.reason not in _BY_FRICTION:
        return plain

    def speed_mps(mu_low: float) -> float:
        curve_mps = curve_speed_mps(section, mu=mu_low, utilisation_frac=policy.utilisation_frac)
        return min(curve_mps, section.speed_limit_mps)

    if not window.support.at_least:
        if standing is None or not window.support.censored_count:
            return plain
        # A provisional interval counts with the lower end of its median.
        careful_ratio = (
            interval.median_low_mu / interval.median_mu if plain.confidence is Confidence.PROVISIONAL else 1.0
        )
        known_mps = min(standing.speed_mps, speed_mps(careful_ratio * mu_low_of_median(window.support.bound_mu)))
        return replace(plain, speed_mps=max(plain.speed_mps, _rounded_down_mps(known_mps)))
    winter_mps = min(policy.winter_speed_mps, section.speed_limit_mps)
    held = standing if window.is_watched else None
    advised_mps = plain.speed_mps if held is None else min(held.speed_mps, section.speed_limit_mps)
    if held is not None and shows_headroom(window.rows, standing=held, policy=probing):
        advised_mps = max(advised_mps, min(advised_mps + kph_to_mps(STEP_KPH), winter_mps))
    sure_mps = speed_mps(window.support.least_mu_low)
    many = window.support.named_count + window.support.censored_count >= probing.sure_count
    advised_mps = max(advised_mps, sure_mps if many else min(sure_mps, winter_mps))
    advised_mps = min([advised_mps, *map(speed_mps, _known_mu_low(window, policy=probing))])
    return replace(plain, speed_mps=_rounded_down_mps(advised_mps), reason=AdvisoryReason.LOWER_CONFIDENCE_BOUND)


def _known_mu_low(window: WindowKnowledge, *, policy: ProbingPolicy) -> list[float]:
    """Return what a worn tyre finds by those of a window who know it, maybe nobody."""
    support, likely = window.support, window.likely
    known = [support.named_mu_low] if support.named_count >= policy.knowing_count else []
    if likely is not None and not likely.at_least and window.likely_count >= policy.likely_count:
        known.append(likely.mu_low)
    return known


def _rounded_down_mps(speed_mps: float) -> float:
    return kph_to_mps(STEP_KPH * max(1, floor((mps_to_kph(speed_mps) + _ROUNDING_KPH) / STEP_KPH)))
