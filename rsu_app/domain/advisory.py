"""From the friction interval to the speed that drivers are told."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, inf

import numpy as np

from roadgrip.records import Advisory, AdvisoryReason, Confidence, FrictionInterval
from roadgrip.section import BankOrigin, RoadSection, SectionProfile
from roadgrip.units import GRAVITY_MPS2, FloatArray, kph_to_mps, mps_to_kph
from rsu_app.domain.interval import mu_low_of_median

STEP_KPH = 5.0
"""Speeds are advised in these steps, and never below one of them."""
_ROUNDING_KPH = 0.02
"""A section stores its limit in steps of 0.01 m/s: 80 km/h comes back as 79.99 and must stay 80."""


@dataclass(frozen=True, slots=True)
class AdvisoryPolicy:
    """What the road authority decides about the advised speed.

    Attributes:
        winter_speed_mps: Advised when too little is known.
        utilisation_frac: Share of the friction that the curve may use up. With the friction ellipse, 0.6 across
            leaves sqrt(1 - 0.6^2) = 0.8 along, for the braking that an obstacle behind the curve asks for; it also
            has to cover what the estimate of a centre line leaves out (a driver's line, grade, gusts).
        rise_margin_mps: By how much the curve speed must exceed the next step before the advice rises to it.
        valid_for_s: How long an advice may be shown after it was received.
    """

    winter_speed_mps: float = kph_to_mps(60.0)
    utilisation_frac: float = 0.6
    rise_margin_mps: float = kph_to_mps(2.0)
    valid_for_s: float = 300.0

    def __post_init__(self) -> None:
        if not self.winter_speed_mps >= kph_to_mps(STEP_KPH):
            raise ValueError(f"a winter speed of {self.winter_speed_mps} m/s is below the lowest advice")
        if not 0.0 < self.utilisation_frac <= 1.0:
            raise ValueError(f"a curve cannot use {self.utilisation_frac} of the friction")
        if not (self.rise_margin_mps >= 0.0 and self.valid_for_s > 0.0):
            raise ValueError("the rise margin must not be negative and an advice must be valid for some time")


def curve_speed_mps(section: RoadSection, *, mu: float, utilisation_frac: float) -> float:
    """Return the speed at which the hardest point of a section uses up its share of the friction.

    At every station the steady turn on a banked road gives

        v^2 = g R (u mu + e) / (1 - u mu e)

    with the inward cross slope e, negative where the road leans outwards. Zero where an outward lean alone eats up
    the share; infinite on a straight line. Only a measured bank is counted on, and its inward part only up to the
    section's cap.

    Args:
        section: The map.
        mu: Friction to reckon with, at least zero.
        utilisation_frac: Share u of it that the turn may use.

    References:
        AASHTO, A Policy on Geometric Design of Highways and Streets, "Horizontal alignment": the basic side friction
        equation, there without the small product u mu e.
    """
    e = inward_bank_ratio(section)
    available = utilisation_frac * mu
    curvature_1pm = np.abs(section.profile.curvature_1pm)
    turning = curvature_1pm > 1e-9
    if not turning.any():
        return inf
    share = np.maximum(0.0, available + e[turning]) / (1.0 - available * e[turning])
    return float(np.sqrt(GRAVITY_MPS2 * np.min(share / curvature_1pm[turning])))


def inward_bank_ratio(section: RoadSection) -> FloatArray:
    """Return the cross slope towards the inside of the turn at every station, as far as advice may count on it.

    Positive helps and is capped at what the section believes; negative is adverse and counts in full. Zero
    everywhere unless the bank was measured. (n,)
    """
    profile: SectionProfile = section.profile
    if section.bank_origin is not BankOrigin.MEASURED:
        return np.zeros_like(profile.curvature_1pm)
    inward = -np.sign(profile.curvature_1pm) * profile.cross_slope_ratio
    return np.minimum(inward, section.bank_cap_ratio)


def advise(
    section: RoadSection,
    *,
    interval: FrictionInterval | None,
    model_live: bool,
    policy: AdvisoryPolicy,
    previous_speed_mps: float | None,
) -> Advisory:
    """Return what drivers are told.

    - Without a model, with fewer vehicles than a provisional interval needs, or with a stale window: winter speed.
    - Provisional interval: the lower of the winter speed and the curve speed for the lower end of the interval that
      the lower confidence bound of the median places.
    - Recommended interval: the curve speed for the lower end of the interval.

    Never above the speed limit. Rounded down to 5 km/h. A lower advice holds at once; a higher one only when the
    curve speed clears the step by a margin.

    Args:
        section: The map.
        interval: The friction interval of now, if there is one.
        model_live: Whether the unit has a model; what the window holds is not trusted without.
        policy: What the road authority decides.
        previous_speed_mps: The advice that stands, if there is one.
    """
    confidence = Confidence.INSUFFICIENT if interval is None else interval.confidence
    winter_mps = min(policy.winter_speed_mps, section.speed_limit_mps)
    friction_mps, cap_mps = inf, winter_mps
    valid_for_s = policy.valid_for_s
    if not model_live:
        reason = AdvisoryReason.WINTER_SPEED_NO_MODEL
    elif interval is None or confidence is Confidence.INSUFFICIENT:
        reason = AdvisoryReason.WINTER_SPEED_FEW_VEHICLES
    elif interval.valid_for_s <= 0.0:
        reason = AdvisoryReason.WINTER_SPEED_STALE_WINDOW
    else:
        valid_for_s = min(valid_for_s, interval.valid_for_s)
        provisional = confidence is Confidence.PROVISIONAL
        mu = mu_low_of_median(interval.median_low_mu) if provisional else interval.mu_low
        friction_mps = curve_speed_mps(section, mu=mu, utilisation_frac=policy.utilisation_frac)
        if not provisional:
            cap_mps = section.speed_limit_mps
            reason = AdvisoryReason.FRICTION_INTERVAL
        elif friction_mps < winter_mps:
            reason = AdvisoryReason.LOWER_CONFIDENCE_BOUND
        else:
            reason = AdvisoryReason.WINTER_SPEED_WHILE_PROVISIONAL
    return Advisory(
        speed_mps=_settled_speed_mps(
            friction_mps=friction_mps,
            cap_mps=cap_mps,
            previous_speed_mps=previous_speed_mps,
            rise_margin_mps=policy.rise_margin_mps,
        ),
        reason=reason,
        confidence=confidence,
        interval=interval,
        valid_for_s=valid_for_s,
    )


def _settled_speed_mps(
    *, friction_mps: float, cap_mps: float, previous_speed_mps: float | None, rise_margin_mps: float
) -> float:
    """Return the advice: the lower of curve speed and cap, rounded down, rising only with a margin.

    Friction is noisy and needs the margin; a cap is a decision and does not.
    """
    speed_mps = _rounded_down_mps(min(friction_mps, cap_mps))
    if previous_speed_mps is None or speed_mps <= previous_speed_mps:
        return speed_mps
    cleared_mps = _rounded_down_mps(min(friction_mps - rise_margin_mps, cap_mps))
    return max(previous_speed_mps, cleared_mps)


def _rounded_down_mps(speed_mps: float) -> float:
    steps = floor((mps_to_kph(speed_mps) + _ROUNDING_KPH) / STEP_KPH)
    return kph_to_mps(STEP_KPH * max(1, steps))
