"""TMeasy: tyre force of combined slip in steady state, and how it builds up over the first decimetres.

What mu means: the steady curves of each axis are scaled so that at the nominal load the peak force is mu times the
load, longitudinally and laterally alike. (The published set has its peaks at 1.12 and 1.008 times the load for a
surface of 0.8.) Friction scales peak and sliding forces and the slips at which they occur, but not the slope at zero
slip: pure slip is self-similar, F(s; mu) = k F(s/k; 1) with k = mu. At other loads the peak is mu times load times the
curve's own degression, so a car corners with slightly less than mu g.

References:
    Rill, Road Vehicle Dynamics, CRC Press, chapter 3 (TMeasy); Rill, First order tire dynamics, III European Conference
    on Computational Mechanics, 2006. Parameters: the passenger-car estimate of Project Chrono, `ChTMeasyTire`.
"""

# ruff: noqa: PLR0917 - the compiler knows no keyword-only arguments

from __future__ import annotations

import math

from vehicle_client.simulator.compilation import formula
from vehicle_client.simulator.vehicle import Tyre

SPEED_FLOOR_MPS = 0.01
"""Added to the rolling speed in every slip, so that a wheel at rest has one."""
LOAD_LIMIT_RATIO = 3.5
"""Over the nominal load; beyond it the parabolas of the load would turn down."""
_NO_SLIP2 = 1e-24


@formula
def slip_slope(
    slip_x_ratio: float, slip_y_ratio: float, load_n: float, friction_mu: float, tyre: Tyre
) -> tuple[float, float, float, float]:
    """Return the secant slope force over normalised slip, both normalisations, and slip over the slip of the peak.

    Forces follow as slope * slip / normalisation per axis. Zero load gives zero slope. Both branches of the curve are
    computed and one is chosen, so that cars side by side take the same path through the code.

    Args:
        slip_x_ratio: Longitudinal, driving positive.
        slip_y_ratio: Lateral, positive where the force points left.
        load_n: Not negative.
        friction_mu: Peak force over load at the nominal load. Positive.
        tyre: The tyre.

    Returns:
        Slope in N, normalisation of x, normalisation of y, slip over peak slip.
    """
    u = min(load_n / tyre.nominal_load_n, LOAD_LIMIT_RATIO)
    kx = friction_mu / tyre.peak_x1_ratio
    ky = friction_mu / tyre.peak_y1_ratio
    w = u - 1.0

    # Everything per newton of load.
    dfx = tyre.slope_x1_ratio + (tyre.slope_x2_ratio - tyre.slope_x1_ratio) * w
    dfy = tyre.slope_y1_ratio + (tyre.slope_y2_ratio - tyre.slope_y1_ratio) * w
    fmx = kx * (tyre.peak_x1_ratio + (tyre.peak_x2_ratio - tyre.peak_x1_ratio) * w)
    fmy = ky * (tyre.peak_y1_ratio + (tyre.peak_y2_ratio - tyre.peak_y1_ratio) * w)
    smx = kx * (tyre.peak_slip_x1_ratio + (tyre.peak_slip_x2_ratio - tyre.peak_slip_x1_ratio) * w)
    smy = ky * (tyre.peak_slip_y1_ratio + (tyre.peak_slip_y2_ratio - tyre.peak_slip_y1_ratio) * w)
    fsx = kx * (tyre.slide_x1_ratio + (tyre.slide_x2_ratio - tyre.slide_x1_ratio) * w)
    fsy = ky * (tyre.slide_y1_ratio + (tyre.slide_y2_ratio - tyre.slide_y1_ratio) * w)
    ssx = kx * (tyre.slide_slip_x1_ratio + (tyre.slide_slip_x2_ratio - tyre.slide_slip_x1_ratio) * w)
    ssy = ky * (tyre.slide_slip_y1_ratio + (tyre.slide_slip_y2_ratio - tyre.slide_slip_y1_ratio) * w)

    # Both axes are brought to slips of comparable effect: hx = smx / (smx + smy) + qx / (qx + qy) with q = fm / df.
    both = smx + smy
    cross_x, cross_y = fmx * dfy, fmy * dfx
    cross = cross_x + cross_y
    hx = (smx * cross + cross_x * both) / (both * cross)
    hy = 2.0 - hx
    inverse = 1.0 / (hx * hy)
    to_x, to_y = hy * inverse, hx * inverse
    sx, sy = slip_x_ratio * to_x, slip_y_ratio * to_y
    # Squares of the direction's cosine and sine; at no slip at all, any direction will do.
    sx2, sy2 = sx * sx + _NO_SLIP2, sy * sy + _NO_SLIP2
    s2 = sx2 + sy2
    share = 1.0 / s2
    c2, d2 = sx2 * share, sy2 * share

    df = math.sqrt((dfx * hx) ** 2 * c2 + (dfy * hy) ** 2 * d2)
    fm = math.sqrt(fmx * fmx * c2 + fmy * fmy * d2)
    sm = math.sqrt((smx * to_x) ** 2 * c2 + (smy * to_y) ** 2 * d2)
    fs = math.sqrt(fsx * fsx * c2 + fsy * fsy * d2)
    ss = math.sqrt((ssx * to_x) ** 2 * c2 + (ssy * to_y) ** 2 * d2)
    s = math.sqrt(s2)
    z = s / sm
    rising = df / (1.0 + (z + df * sm / fm - 2.0) * z)
    slope = rising if z < 1.0 else _beyond_peak(s, df, fm, sm, fs, ss) / s
    return slope * u * tyre.nominal_load_n, hx, hy, z


@formula
def _beyond_peak(s: float, df: float, fm: float, sm: float, fs: float, ss: float) -> float:
    # The first parabola has the curvature that the rising branch ends with; the second meets the sliding force. Where
    # they do not meet in time, a cubic takes their place.
    a = (fm / sm) ** 2 / (df * sm)
    join = sm + (fm - fs) / (a * (ss - sm))
    first = fm - a * (s - sm) ** 2
    second = fs + a * (join - sm) / (ss - join) * (ss - s) ** 2
    t = (s - sm) / (ss - sm)
    cubic = fm - (fm - fs) * t * t * (3.0 - 2.0 * t)
    falling = first if s <= join else second
    falling = falling if join < ss else cubic
    return falling if s < ss else fs


@formula
def steady_force_n(
    slip_x_ratio: float, slip_y_ratio: float, load_n: float, friction_mu: float, tyre: Tyre
) -> tuple[float, float]:
    """Return the longitudinal and lateral force of a tyre that has rolled far enough at a constant slip.

    Args:
        slip_x_ratio: Longitudinal, driving positive.
        slip_y_ratio: Lateral, positive where the force points left.
        load_n: Not negative.
        friction_mu: Peak force over load at the nominal load. Positive.
        tyre: The tyre.
    """
    slope, hx, hy, _ = slip_slope(slip_x_ratio, slip_y_ratio, load_n, friction_mu, tyre)
    return slope * slip_x_ratio / hx, slope * slip_y_ratio / hy


@formula
def built_up_force_n(
    bristle_m: float,
    sliding_mps: float,
    rolling_mps: float,
    slope_n: float,
    normalisation_ratio: float,
    stiffness_npm: float,
    damping_nspm: float,
    step_s: float,
) -> tuple[float, float, float]:
    """Return the carcass deflection after a step, the force in its middle, and how much it falls per sliding speed.

    The deflection is integrated by the implicit midpoint rule, stable at any speed and step. The force is
    `force_at_rest - loss * sliding_mps` with everything that does not depend on the sliding speed in the former, so
    that the wheel spin can be solved together with it.

    Args:
        bristle_m: Deflection before the step.
        sliding_mps: Speed of the contact patch over the ground in the middle of the step, in the direction of the axis.
        rolling_mps: Rotation times radius, not negative, floor included.
        slope_n: From `slip_slope`.
        normalisation_ratio: From `slip_slope`, of this axis.
        stiffness_npm: Of the carcass, this axis.
        damping_nspm: Of the carcass, this axis.
        step_s: Time step.

    Returns:
        New deflection in m, force in N, loss in N per m/s.

    References:
        Rill 2006: xe' = -(vt h c xe + f vs) / (vt h d + f), F = c xe + d xe'.
    """
    vt_h = rolling_mps * normalisation_ratio
    inertia = vt_h * damping_nspm + slope_n
    share = 1.0 / (inertia + 0.5 * step_s * vt_h * stiffness_npm)
    speed = -(vt_h * stiffness_npm * bristle_m + slope_n * sliding_mps) * share
    force = stiffness_npm * (bristle_m + 0.5 * step_s * speed) + damping_nspm * speed
    loss = (0.5 * stiffness_npm * step_s + damping_nspm) * slope_n * share
    return bristle_m + step_s * speed, force, loss
