"""Estimation and statistics sample by sample: plain Python floats, lists and `math`, no arrays.

What somebody writes who takes the equations one after the other, with care: filters as one convolution with taps
computed once, products instead of powers, a pointer that walks along the map, the samples sorted once per signal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import mul
from typing import TYPE_CHECKING

from roadgrip.units import GRAVITY_MPS2, SAMPLE_RATE_HZ, SAMPLE_S
from vehicle_client.estimation.filters import CUTOFF_HZ, TAPS_COUNT
from vehicle_client.estimation.observer import SPEED_FLOOR_MPS
from vehicle_client.estimation.wheel_speed import STRAY_FRAC, STRAY_MPS, WEIGHT_FLOOR

if TYPE_CHECKING:
    from bench.speed.steps import Steps
    from vehicle_client.estimation.observer import ObserverParameters
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

Series = list[float]


@dataclass(frozen=True, slots=True)
class Recorded:
    """A drive as lists of floats: as a program without arrays would have gathered it."""

    accel_x_mps2: Series
    accel_y_mps2: Series
    roll_rate_radps: Series
    yaw_rate_radps: Series
    steer_rad: Series
    wheel_speed_mps: list[Series]
    station_m: Series
    inside: list[bool]
    map_station_m: Series
    map_cross_slope_ratio: Series
    map_grade_ratio: Series


def recorded(steps: Steps) -> Recorded:
    """Return the input as lists; not part of what is measured."""
    trace, profile = steps.trace, steps.section.profile
    return Recorded(
        accel_x_mps2=trace.accel_x_mps2.tolist(),
        accel_y_mps2=trace.accel_y_mps2.tolist(),
        roll_rate_radps=trace.roll_rate_radps.tolist(),
        yaw_rate_radps=trace.yaw_rate_radps.tolist(),
        steer_rad=trace.steer_rad.tolist(),
        wheel_speed_mps=[trace.wheel_speed_mps[:, i].tolist() for i in range(4)],
        station_m=steps.station_m.tolist(),
        inside=steps.inside.tolist(),
        map_station_m=profile.station_m.tolist(),
        map_cross_slope_ratio=profile.cross_slope_ratio.tolist(),
        map_grade_ratio=profile.grade_ratio.tolist(),
    )


def values(drive: Recorded, steps: Steps) -> Series:
    """Return the kinematic features. (55)"""
    parameters, vehicle, offsets = steps.parameters, steps.vehicle, steps.offsets
    yaw_rate = [value - offsets.yaw_rate_radps for value in drive.yaw_rate_radps]
    accel_y = smoothed([value - offsets.accel_y_mps2 for value in drive.accel_y_mps2])
    steer = smoothed([value - offsets.steer_rad for value in drive.steer_rad])
    bank = [
        math.atan(slope) for slope in interpolated(drive.station_m, drive.map_station_m, drive.map_cross_slope_ratio)
    ]
    climb = [math.atan(grade) for grade in interpolated(drive.station_m, drive.map_station_m, drive.map_grade_ratio)]
    forward = smoothed([value - offsets.accel_x_mps2 for value in drive.accel_x_mps2])
    accel_x = [a - GRAVITY_MPS2 * math.sin(slope) for a, slope in zip(forward, climb, strict=True)]

    def speed_given(velocity_y: Series) -> Series:
        return encoder_speed(
            drive.wheel_speed_mps, yaw_rate, steer, accel_x, velocity_y, vehicle=vehicle, parameters=parameters
        )

    speed = speed_given([0.0] * len(yaw_rate))
    gripping = gripping_velocity(accel_y, yaw_rate, speed, vehicle, parameters)
    speed = speed_given(gripping)
    roll = chassis_roll(
        drive, accel_y, yaw_rate, speed, gripping, bank=bank, climb=climb, crossover_hz=parameters.roll_crossover_hz
    )
    road_accel_y = [
        (a - GRAVITY_MPS2 * math.sin(r + b)) / math.cos(r + b) for a, r, b in zip(accel_y, roll, bank, strict=True)
    ]
    rate = sideslip_rate(road_accel_y, yaw_rate, speed)
    straight = straightness(yaw_rate, steer, rate, parameters)
    ahead, left = both_ways(accel_x, road_accel_y, yaw_rate, speed, straight, gripping=gripping, parameters=parameters)
    sideslip = [math.atan(y / max(x, SPEED_FLOOR_MPS)) for x, y in zip(smoothed(ahead), smoothed(left), strict=True)]
    excess = []
    for w, v, delta in zip(yaw_rate, speed, steer, strict=True):
        t = math.tan(delta)
        excess.append(w - 2.0 * v * t / (2.0 * vehicle.wheelbase_m + vehicle.track_m * abs(t)))
    result: Series = []
    for signal in (steer, sideslip, rate, excess, [max(v, 0.0) for v in speed]):
        result += statistics([value for value, counts in zip(signal, drive.inside, strict=True) if counts])
    return result


def two_way_taps() -> Series:
    """Return the response of the smoothing filter and of itself backwards. (61)"""
    middle = (TAPS_COUNT - 1) / 2.0
    one_way = []
    for k in range(TAPS_COUNT):
        at = 2.0 * math.pi * CUTOFF_HZ / SAMPLE_RATE_HZ * (k - middle)
        window = 0.54 - 0.46 * math.cos(2.0 * math.pi * k / (TAPS_COUNT - 1))
        one_way.append(window * (math.sin(at) / at if at else 1.0))
    total = sum(one_way)
    both = [0.0] * (2 * TAPS_COUNT - 1)
    for i, a in enumerate(one_way):
        for j, b in enumerate(one_way):
            both[i + j] += a / total * b / total
    return both


TWO_WAY_TAPS = two_way_taps()


def smoothed(signal: Series) -> Series:
    """Return the signal low-passed forward and backward, continued point-symmetrically beyond its ends."""
    edge = TAPS_COUNT - 1
    extended = [2.0 * signal[0] - signal[k] for k in range(edge, 0, -1)]
    extended += signal
    extended += [2.0 * signal[-1] - signal[-1 - k] for k in range(1, edge + 1)]
    width = len(TWO_WAY_TAPS)
    return [sum(map(mul, TWO_WAY_TAPS, extended[k : k + width])) for k in range(len(signal))]


def rate_of_change(signal: Series) -> Series:
    """Return the derivative by central differences."""
    inner = [(after - before) / (2.0 * SAMPLE_S) for before, after in zip(signal, signal[2:], strict=False)]
    return [(signal[1] - signal[0]) / SAMPLE_S, *inner, (signal[-1] - signal[-2]) / SAMPLE_S]


def interpolated(at: Series, known_at: Series, known: Series) -> Series:
    """Return known values between their places, which never decrease; held beyond them."""
    result, k = [], 0
    last = len(known_at) - 1
    for place in at:
        while k < last and known_at[k + 1] <= place:
            k += 1
        if place <= known_at[0] or k == last:
            result.append(known[k])
        else:
            share = (place - known_at[k]) / (known_at[k + 1] - known_at[k])
            result.append(known[k] + share * (known[k + 1] - known[k]))
    return result


def encoder_speed(
    wheels: list[Series],
    yaw_rate: Series,
    steer: Series,
    accel_x: Series,
    velocity_y: Series,
    *,
    vehicle: VehicleGeometry,
    parameters: ObserverParameters,
) -> Series:
    """Return the forward speed from four wheels, each weighed by whether it is believed."""
    front, half_track = vehicle.front_axle_m, vehicle.track_m / 2.0
    speeds: list[Series] = [[], [], [], []]
    for k, w in enumerate(yaw_rate):
        sine, cosine = math.sin(steer[k]), math.cos(steer[k])
        across = (velocity_y[k] + w * front) * sine
        speeds[0].append((wheels[0][k] - across) / cosine + w * half_track)
        speeds[1].append((wheels[1][k] - across) / cosine - w * half_track)
        speeds[2].append(wheels[2][k] + w * half_track)
        speeds[3].append(wheels[3][k] - w * half_track)
    gains = [rate_of_change(smoothed(speed)) for speed in speeds]
    result = []
    for k, expected in enumerate(accel_x):
        steady = abs(expected) < parameters.accel_x_threshold_mps2
        sigma = parameters.sigma_wheel_steady_mps2 if steady else parameters.sigma_wheel_accelerating_mps2
        four = [speed[k] for speed in speeds]
        ordered = sorted(four)
        median = (ordered[1] + ordered[2]) / 2.0
        total = weight_sum = 0.0
        for speed_now, gain in zip(four, gains, strict=True):
            if abs(speed_now - median) > STRAY_MPS + STRAY_FRAC * abs(median):
                weight = WEIGHT_FLOOR * WEIGHT_FLOOR
            else:
                mismatch = (gain[k] - expected) / sigma
                weight = max(math.exp(-0.5 * mismatch * mismatch), WEIGHT_FLOOR)
            total += weight * speed_now
            weight_sum += weight
        result.append(total / weight_sum)
    return smoothed(result)


def gripping_velocity(
    accel_y: Series, yaw_rate: Series, speed: Series, vehicle: VehicleGeometry, parameters: ObserverParameters
) -> Series:
    """Return the lateral velocity while the rear tyres grip."""
    rear, slip, share = vehicle.rear_axle_m, parameters.rear_slip_gradient_s2pm, parameters.grip_pull_ratio
    return smoothed([share * (rear * w - slip * v * a) for a, w, v in zip(accel_y, yaw_rate, speed, strict=True)])


def chassis_roll(
    drive: Recorded,
    accel_y: Series,
    yaw_rate: Series,
    speed: Series,
    gripping: Series,
    *,
    bank: Series,
    climb: Series,
    crossover_hz: float,
) -> Series:
    """Return the roll of the body against the road, by the complementary filter."""
    rolling = [p - w * math.tan(c) for p, w, c in zip(drive.roll_rate_radps, yaw_rate, climb, strict=True)]
    turned = [0.0]
    for k in range(1, len(rolling)):
        turned.append(turned[-1] + (rolling[k] + rolling[k - 1]) * SAMPLE_S / 2.0)
    gain = rate_of_change(gripping)
    apart = []
    for k, angle in enumerate(turned):
        sine = (accel_y[k] - yaw_rate[k] * speed[k] - gain[k]) / GRAVITY_MPS2
        apart.append(math.asin(min(1.0, max(-1.0, sine))) - angle)
    slow = slow_part(apart, crossover_hz)
    return [angle + s - b for angle, s, b in zip(turned, slow, bank, strict=True)]


def slow_part(signal: Series, crossover_hz: float) -> Series:
    """Return what is slower than the crossover: the tridiagonal equations, by elimination."""
    n, w = len(signal), 1.0 / (2.0 * math.pi * crossover_hz * SAMPLE_S) ** 2
    ratio, carried = w / (1.0 + w), signal[0] / (1.0 + w)
    ratios, result = [ratio], [carried]
    for k in range(1, n):
        pivot = (1.0 + 2.0 * w if k < n - 1 else 1.0 + w) - w * ratio
        ratio, carried = w / pivot, (signal[k] + w * carried) / pivot
        ratios.append(ratio)
        result.append(carried)
    for k in range(n - 2, -1, -1):
        result[k] += ratios[k] * result[k + 1]
    return result


def sideslip_rate(accel_y: Series, yaw_rate: Series, speed: Series) -> Series:
    """Return the sideslip rate, smoothed."""
    result = []
    for a, w, v in zip(accel_y, yaw_rate, speed, strict=True):
        floored = max(v, SPEED_FLOOR_MPS)
        result.append((a - w * floored) / floored)
    return smoothed(result)


def straightness(yaw_rate: Series, steer: Series, rate: Series, parameters: ObserverParameters) -> Series:
    """Return F(t): 1 on a straight, towards 0 in action."""
    p = parameters
    yaw_rate = smoothed(yaw_rate)
    pairs = [
        (yaw_rate, p.sigma_yaw_rate_radps),
        (rate_of_change(yaw_rate), p.sigma_yaw_accel_radps2),
        (steer, p.sigma_steer_rad),
        (rate_of_change(steer), p.sigma_steer_rate_radps),
        (rate, p.sigma_sideslip_rate_radps),
        (rate_of_change(rate), p.sigma_sideslip_accel_radps2),
    ]
    result = []
    for k in range(len(rate)):
        exponent = 0.0
        for signal, sigma in pairs:
            scaled = signal[k] / sigma
            exponent += scaled * scaled
        result.append(math.exp(-0.5 * exponent))
    return result


def both_ways(
    accel_x: Series,
    accel_y: Series,
    yaw_rate: Series,
    speed: Series,
    straight: Series,
    *,
    gripping: Series,
    parameters: ObserverParameters,
) -> tuple[Series, Series]:
    """Return the mean of the observer run forward and backward in time."""
    there_x, there_y = observed(accel_x, accel_y, yaw_rate, speed, straight, gripping=gripping, parameters=parameters)
    back_x, back_y = observed(
        [-a for a in reversed(accel_x)],
        [-a for a in reversed(accel_y)],
        [-w for w in reversed(yaw_rate)],
        speed[::-1],
        straight[::-1],
        gripping=gripping[::-1],
        parameters=parameters,
    )
    back_x.reverse()
    back_y.reverse()
    return (
        [(there + back) / 2.0 for there, back in zip(there_x, back_x, strict=True)],
        [(there + back) / 2.0 for there, back in zip(there_y, back_y, strict=True)],
    )


def observed(
    accel_x: Series,
    accel_y: Series,
    yaw_rate: Series,
    speed: Series,
    straight: Series,
    *,
    gripping: Series,
    parameters: ObserverParameters,
) -> tuple[Series, Series]:
    """Return both velocities of the observer, one trapezoidal step after the other."""
    half, coupling = SAMPLE_S / 2.0, parameters.alpha_2_ratio
    x, y = speed[0], gripping[0]
    forward, left = [x], [y]
    before: tuple[float, ...] = ()
    for k, w in enumerate(yaw_rate):
        pull = parameters.alpha_0_1ps + parameters.alpha_1_ratio * abs(w)
        a00, a01, a10, a11 = -half * pull, half * w, -half * (coupling + 1.0) * w, -half * straight[k]
        u0 = half * (accel_x[k] + pull * speed[k])
        u1 = half * (accel_y[k] + coupling * w * speed[k] + straight[k] * gripping[k])
        if before:
            b00, b01, b10, b11, v0, v1 = before
            right_x = x + b00 * x + b01 * y + v0 + u0
            right_y = y + b10 * x + b11 * y + v1 + u1
            n00, n11 = 1.0 - a00, 1.0 - a11
            scale = 1.0 / (n00 * n11 - a01 * a10)
            x, y = (n11 * right_x + a01 * right_y) * scale, (n00 * right_y + a10 * right_x) * scale
            forward.append(x)
            left.append(y)
        before = (a00, a01, a10, a11, u0, u1)
    return forward, left


def statistics(samples: Series) -> Series:
    """Return the eleven statistics of a bag of samples."""
    ordered = sorted(samples)
    n = len(ordered)
    mean = sum(ordered) / n
    second = third = fourth = 0.0
    for value in ordered:
        deviation = value - mean
        square = deviation * deviation
        second += square
        third += square * deviation
        fourth += square * square
    std = math.sqrt(second / n)
    q20, q40, median, q60, q80 = (quantile(ordered, share) for share in (0.2, 0.4, 0.5, 0.6, 0.8))
    skewness, kurtosis = third / n / std**3, fourth / n / std**4 - 3.0
    return [mean, std, q20, q40, q60, q80, ordered[0], median, ordered[-1], skewness, kurtosis]


def quantile(ordered: Series, share: float) -> float:
    """Return a quantile of sorted samples, linear between neighbours."""
    at = share * (len(ordered) - 1)
    below = int(at)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (at - below)
