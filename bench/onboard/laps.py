"""A race track driven again and again: where on the lap the car is, and the bank that its other laps tell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadgrip.units import GRAVITY_MPS2, SAMPLE_S, FloatArray
from vehicle_client.estimation.filters import integral, rate_of_change, slow_part, smoothed

_STEP_M = 2.0
_WINDOW_M = 500.0
_EVERY_M = 50.0
_STRAY_M = 60.0
_ALIKE_MIN = 0.9
"""Correlation of the curvature from which on two stretches are taken for the same bend."""
_CELL_M = 5.0
_BANK_CROSSOVER_HZ = 0.5
"""Faster is the car's shaking, not the road."""


@dataclass(frozen=True, slots=True)
class Laps:
    """Where a car is on a closed track.

    Attributes:
        lap_m: Length of a lap.
        lap_number: Which lap, from 0. (n,)
        station_m: Along the lap. (n,)
    """

    lap_m: float
    lap_number: NDArray[np.int_]
    station_m: FloatArray

    @property
    def laps_count(self) -> float:
        """Laps driven, the last one perhaps in part."""
        return float(self.lap_number[-1]) + float(self.station_m[-1]) / self.lap_m


def laps_of(speed_mps: FloatArray, yaw_rate_radps: FloatArray) -> Laps:
    """Return where on the lap a car is, by the bends it comes through again.

    Args:
        speed_mps: Forward, never near zero. (n,)
        yaw_rate_radps: Left turn positive. (n,)
    """
    driven_m = integral(speed_mps)
    grid_m = np.arange(0.0, driven_m[-1], _STEP_M)
    bend_1pm = np.interp(grid_m, driven_m, smoothed(yaw_rate_radps) / speed_mps)
    shifts = np.arange(int(1000.0 / _STEP_M), len(grid_m) // 2)
    alike = [float(np.corrcoef(bend_1pm[:-shift], bend_1pm[shift:])[0, 1]) for shift in shifts]
    lap_m = float(shifts[int(np.argmax(alike))]) * _STEP_M
    back_m = _distance_to_last_lap_m(bend_1pm, lap_m)
    station_m = driven_m.copy()
    for _ in range(int(driven_m[-1] / lap_m) + 1):
        station_m -= np.where(station_m >= lap_m, np.interp(station_m, *back_m), 0.0)
    station_m = np.maximum(station_m, 0.0)
    # A lap driven on a longer line ends a little late: the number is what the distance says, less what was folded.
    number = np.rint((driven_m - station_m) / lap_m).astype(int)
    return Laps(lap_m=lap_m, lap_number=number, station_m=np.mod(station_m, lap_m))


def bank_of_other_laps_rad(gravity_mps2: FloatArray, laps: Laps) -> FloatArray:
    """Return for every sample the bank at its place as all other laps tell it, left edge up positive. (n,)

    Args:
        gravity_mps2: What an accelerometer read to the left beyond the acceleration of the car. (n,)
        laps: Where the car was.
    """
    slow = slow_part(gravity_mps2, crossover_hz=_BANK_CROSSOVER_HZ)
    cells_count = int(np.ceil(laps.lap_m / _CELL_M))
    cell = np.minimum((laps.station_m / _CELL_M).astype(int), cells_count - 1)
    middle_m = (np.arange(cells_count) + 0.5) * _CELL_M
    result = np.empty_like(slow)
    for number in np.unique(laps.lap_number):
        own = laps.lap_number == number
        count = np.bincount(cell[~own], minlength=cells_count)
        mean = np.bincount(cell[~own], slow[~own], cells_count) / np.maximum(count, 1)
        result[own] = np.interp(laps.station_m[own], middle_m, mean, period=laps.lap_m)
    return np.arcsin(np.clip(result / GRAVITY_MPS2, -1.0, 1.0))


def gravity_by_reference_mps2(
    accel_y_mps2: FloatArray, yaw_rate_radps: FloatArray, velocity_x_mps: FloatArray, velocity_y_mps: FloatArray
) -> FloatArray:
    """Return what an accelerometer reads to the left beyond the acceleration that a reference instrument tells. (n,)

    Args:
        accel_y_mps2: Specific force to the left. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        velocity_x_mps: Of the reference, forward. (n,)
        velocity_y_mps: Of the reference, left. (n,)
    """
    moving = rate_of_change(smoothed(velocity_y_mps)) + smoothed(yaw_rate_radps) * smoothed(velocity_x_mps)
    return smoothed(accel_y_mps2) - moving


def repeats_correlation(values: FloatArray, laps: Laps, speed_mps: FloatArray) -> float:
    """Return how alike a quantity is at the same places of one lap and the next.

    Args:
        values: Any quantity. (n,)
        laps: Where the car was.
        speed_mps: Forward. (n,)
    """
    first: list[FloatArray] = []
    then: list[FloatArray] = []
    for number in np.unique(laps.lap_number)[:-1]:
        here, there = laps.lap_number == number, laps.lap_number == number + 1
        stations = laps.station_m[here][:: max(1, int(_CELL_M / (float(speed_mps.mean()) * SAMPLE_S)))]
        inside = stations[(stations < laps.station_m[there].max()) & (stations > laps.station_m[there].min())]
        for chosen, into in ((here, first), (there, then)):
            order = np.argsort(laps.station_m[chosen])
            into.append(np.interp(inside, laps.station_m[chosen][order], values[chosen][order]))
    return float(np.corrcoef(np.concatenate(first), np.concatenate(then))[0, 1])


def _distance_to_last_lap_m(bend_1pm: FloatArray, lap_m: float) -> tuple[FloatArray, FloatArray]:
    """Return at some distances driven how long ago the car came by the same place; bends tell it, straights do not."""
    half = int(_WINDOW_M / _STEP_M / 2)
    at, back = [], []
    for middle in range(int(lap_m / _STEP_M) + half + 50, len(bend_1pm) - half, int(_EVERY_M / _STEP_M)):
        window = bend_1pm[middle - half : middle + half]
        best = (-1.0, 0)
        for shift in range(int((lap_m - _STRAY_M) / _STEP_M), int((lap_m + _STRAY_M) / _STEP_M) + 1):
            begin = middle - half - shift
            if begin < 0:
                continue
            best = max(best, (float(np.corrcoef(window, bend_1pm[begin : begin + 2 * half])[0, 1]), shift))
        if best[0] > _ALIKE_MIN:
            at.append(middle * _STEP_M)
            back.append(best[1] * _STEP_M)
    return np.array(at), np.array(back)
