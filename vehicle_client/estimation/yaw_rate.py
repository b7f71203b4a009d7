"""How much faster a vehicle yaws than its steering asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.units import FloatArray


def intended_yaw_rate_radps(
    speed_mps: FloatArray, steer_rad: FloatArray, *, wheelbase_m: float, track_m: float
) -> FloatArray:
    """Return the yaw rate of a vehicle that rolls where its front wheels point. (n,)

    The paper writes 2 V tan(delta) / (2 b + L tan(delta)), which turns a left curve into another number than the
    same curve seen in a mirror (5.8 % at 0.1 rad). We take |tan(delta)| below, so the formula is the paper's for a
    left turn and its mirror image for a right turn.

    Exact for the angle of the inner front wheel. The paper puts the mean of both in, and so do we: a car that rolls
    without slip then yaws faster than intended by the share L |tan(delta)| / (2 b), 2.8 % at 0.1 rad.

    Args:
        speed_mps: Forward. (n,)
        steer_rad: Mean angle of the front wheels, left positive, within a quarter turn. (n,)
        wheelbase_m: The paper's b.
        track_m: The paper's L.

    References:
        Langstrand and Rabi, Learning to cooperatively estimate road surface friction, section "Estimating yaw rate
        excess".
    """
    t = np.tan(steer_rad)
    return 2.0 * speed_mps * t / (2.0 * wheelbase_m + track_m * np.abs(t))


def yaw_rate_excess_radps(
    yaw_rate_radps: FloatArray,
    speed_mps: FloatArray,
    steer_rad: FloatArray,
    *,
    wheelbase_m: float,
    track_m: float,
) -> FloatArray:
    """Return how much faster the vehicle yaws than its steering asks for. (n,)

    Positive in a left turn means oversteer, negative there understeer. NaN in, NaN out; at standstill the yaw rate
    itself.

    Args:
        yaw_rate_radps: Measured, left turn positive. (n,)
        speed_mps: Forward. (n,)
        steer_rad: Mean angle of the front wheels, left positive. (n,)
        wheelbase_m: Front to rear axle.
        track_m: Left to right wheel.

    References:
        As `intended_yaw_rate_radps`, whose deviation from the paper keeps the mirror.
    """
    return yaw_rate_radps - intended_yaw_rate_radps(speed_mps, steer_rad, wheelbase_m=wheelbase_m, track_m=track_m)
