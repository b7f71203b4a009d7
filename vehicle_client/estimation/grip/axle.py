"""The slip that an axle needs for its forces, for many frictions at once: the tyre curve read backwards.

Two wheels on one axle share a slip angle but not a load. A curve for the axle as a whole is inverted in closed form,
then one Newton step on the sum of both wheels' own curves mends what their different loads change.

References:
    Rill, Road Vehicle Dynamics, chapter 3: F = dF0 s / (1 + (z + p) z), z = s / sM, p = dF0 sM / FM - 2. With
    q = dF0 sM / F - p this is z + 1/z = q.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.handling import TyreCurve

FULL_USE_RATIO = 0.995
"""Share of the peak force up to which the curve is read; at the peak any slip would do."""
_LEAST_FORCE_N = 1.0
_LEAST_RATIO = 0.1
"""Of what holds at the nominal load: lines through two loads, drawn on, would cross zero."""
_CORRECTION_LIMIT_RATIO = 0.15
"""Of the slip angle; near the peak the closed form is closer than a long Newton step."""
_CORRECTION_FLOOR_RAD = 1e-4


@dataclass(frozen=True, slots=True)
class WheelCurve:
    """The curve of one wheel under its load, at friction 1. All arrays (n,).

    Attributes:
        stiffness_n: Lateral force per slip angle at small slip.
        peak_n: Peak force.
        peak_slip_ratio: Slip of the peak.
        along_ratio: Longitudinal slip stiffness over the lateral one.
    """

    stiffness_n: FloatArray
    peak_n: FloatArray
    peak_slip_ratio: FloatArray
    along_ratio: FloatArray


@dataclass(frozen=True, slots=True)
class AxleSlip:
    """What an axle needs. All arrays (frictions, n).

    Attributes:
        angle_rad: Slip angle, positive where the force points left.
        along_per_force_1pn: Longitudinal slip per longitudinal force.
        angle_per_force_radpn: How much more angle a little more lateral force needs.
        use_ratio: Force over what the friction gives; above 1 it cannot be.
    """

    angle_rad: FloatArray
    along_per_force_1pn: FloatArray
    angle_per_force_radpn: FloatArray
    use_ratio: FloatArray


def wheel_curve(load_n: FloatArray, tyre: TyreCurve) -> WheelCurve:
    """Return the curve of a wheel: all ratios change linearly with the load, down to a tenth of the nominal one.

    Args:
        load_n: Positive. (n,)
        tyre: The tyre.
    """
    more = load_n / tyre.nominal_load_n - 1.0

    def at_load(once_ratio: float, twice_ratio: float) -> FloatArray:
        return np.maximum(once_ratio + (twice_ratio - once_ratio) * more, _LEAST_RATIO * once_ratio)

    stiffness = at_load(tyre.stiffness_ratio, tyre.stiffness_twice_ratio)
    return WheelCurve(
        stiffness_n=load_n * stiffness,
        peak_n=load_n * at_load(1.0, tyre.peak_twice_ratio),
        peak_slip_ratio=at_load(tyre.peak_slip_ratio, tyre.peak_slip_twice_ratio),
        along_ratio=tyre.along_stiffness_ratio / stiffness,
    )


def axle_slip(
    friction_mu: FloatArray,
    lateral_n: FloatArray,
    along_n: FloatArray,
    wheels: tuple[WheelCurve, WheelCurve],
) -> AxleSlip:
    """Return the slip an axle needs for its forces, at each friction.

    Beyond `FULL_USE_RATIO` of the peak the slip is that of `FULL_USE_RATIO`.

    Args:
        friction_mu: Positive. (frictions, 1)
        lateral_n: Lateral force of both wheels together, left positive. (n,)
        along_n: Longitudinal force of both together, driving positive. (n,)
        wheels: The two wheels' curves at friction 1.
    """
    stiffness = wheels[0].stiffness_n + wheels[1].stiffness_n
    peak = wheels[0].peak_n + wheels[1].peak_n
    peak_slip = (wheels[0].peak_n * wheels[0].peak_slip_ratio + wheels[1].peak_n * wheels[1].peak_slip_ratio) / peak
    resultant = np.sqrt(lateral_n**2 + along_n**2) + _LEAST_FORCE_N
    across_share, along_share = lateral_n / resultant, along_n / resultant
    use = resultant / (friction_mu * peak)
    read = np.minimum(use, FULL_USE_RATIO)
    steepness = stiffness * peak_slip / peak
    q = steepness / read - (steepness - 2.0)
    root = np.sqrt(q * q - 4.0)
    over_peak = 0.5 * (q - root)
    slip = friction_mu * peak_slip * over_peak
    slip_per_n = steepness * over_peak * peak_slip / (read * read * root * peak)
    angle = slip * across_share
    angle_per_n = slip_per_n * across_share**2 + slip * along_share**2 / resultant

    stiff = [_secant_stiffness_n(slip, friction_mu, wheel) for wheel in wheels]
    missing = lateral_n - (stiff[0] + stiff[1]) * angle
    limit = _CORRECTION_LIMIT_RATIO * np.abs(angle) + _CORRECTION_FLOOR_RAD
    angle = angle + np.clip(missing * angle_per_n, -limit, limit)
    # An open differential drives both wheels with the same torque: the less loaded one slips more.
    along_per_n = 0.25 / (stiff[0] * wheels[0].along_ratio) + 0.25 / (stiff[1] * wheels[1].along_ratio)
    return AxleSlip(angle_rad=angle, along_per_force_1pn=along_per_n, angle_per_force_radpn=angle_per_n, use_ratio=use)


def _secant_stiffness_n(slip: FloatArray, friction_mu: FloatArray, wheel: WheelCurve) -> FloatArray:
    """Return force over slip of one wheel; the peak force over the slip beyond its peak. (frictions, n)"""
    steepness = wheel.stiffness_n * wheel.peak_slip_ratio / wheel.peak_n
    z = slip / (friction_mu * wheel.peak_slip_ratio)
    rising = wheel.stiffness_n / (1.0 + (z + (steepness - 2.0)) * z)
    return np.where(z < 1.0, rising, wheel.peak_n / wheel.peak_slip_ratio / np.maximum(z, 1.0))
