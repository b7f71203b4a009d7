"""The lanes as seen from outside: drives are seated in free ones, driven, and their logs taken."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.simulator import journey
from vehicle_client.simulator.driver import understeer_gradient_s2pm
from vehicle_client.simulator.lanes import (
    ABS_ON,
    DRIVER,
    ESC_ON,
    GRADIENT,
    LANES,
    LEVER_X,
    LEVER_Y,
    REPORT_COUNT,
    STATE_SIZE,
    TCS_ON,
    WHEELS,
)
from vehicle_client.simulator.track import COLUMNS_COUNT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roadgrip.units import FloatArray
    from vehicle_client.simulator.plan import Driver, StabilitySystems
    from vehicle_client.simulator.vehicle import Vehicle

_SPARE = 1.25
"""How much longer than needed tables are made, so that the next drive may fit too."""


class Lanes:
    """`LANES` drives side by side. Its arrays are what the compiled code works on; nobody else changes them."""

    def __init__(self) -> None:
        """Make room; all lanes are free."""
        self.state = np.zeros(STATE_SIZE)
        self._counts = np.zeros((journey.COUNTS_SIZE, LANES), dtype=np.int64)
        self._counts[journey.ENDING] = journey.IDLE
        self._lines = np.zeros((LANES, 0, COLUMNS_COUNT))
        self._rough_m = np.zeros((LANES, 0, 2))
        self._log = np.zeros((LANES, REPORT_COUNT, 0))

    def free(self) -> list[int]:
        """Return the lanes in which nobody drives."""
        idle = self._counts[journey.ENDING] == journey.IDLE
        return [int(lane) for lane in np.flatnonzero(idle)]

    def seat(
        self,
        lane: int,
        *,
        vehicle: Vehicle,
        driver: Driver,
        stability: StabilitySystems,
        lines: FloatArray,
        rough_m: FloatArray,
        samples_limit_count: int,
        rows: Mapping[int, float],
    ) -> None:
        """Place a car with its driver at the start of his road.

        Args:
            lane: A free one.
            vehicle: The car.
            driver: The driver.
            stability: Which of its systems work.
            lines: As in `track.Track`. (n, 12)
            rough_m: Height of both wheel tracks every 0.1 m; without rows for a plane. (k, 2)
            samples_limit_count: After so many samples the drive times out.
            rows: Further rows of the state, and their values.
        """
        place_car(self.state, lane, vehicle=vehicle, driver=driver, stability=stability)
        places = self.state.reshape(-1, 4, LANES)[:, :, lane]
        for row, value in rows.items():
            places[row // WHEELS] = value
        self._lines = _with_room(self._lines, lines.shape)
        self._lines[lane, : len(lines)] = lines
        self._rough_m = _with_room(self._rough_m, rough_m.shape)
        self._rough_m[lane, : len(rough_m)] = rough_m
        if self._log.shape[2] < samples_limit_count:
            # No log is lost: whoever drives keeps what he has logged so far. The rest is not touched, so that it costs
            # no memory before somebody drives as long.
            kept_count = self._counts[journey.SAMPLE].max()
            longer = np.empty((LANES, REPORT_COUNT, samples_limit_count))
            longer[:, :, :kept_count] = self._log[:, :, :kept_count]
            self._log = longer
        self._counts[:, lane] = 0, samples_limit_count, len(lines) - 1, len(rough_m) - 1, journey.RUNNING

    def drive(self, step_s: float) -> list[tuple[int, int, FloatArray]]:
        """Drive until someone has come to an end, and return for each who has: lane, ending, log. (columns, n)"""
        journey.drive(self.state, self._counts, self._lines, self._rough_m, self._log, step_s)
        ended = []
        for lane in np.flatnonzero(self._counts[journey.ENDING] >= 0):
            samples_count = self._counts[journey.SAMPLE, lane]
            ended.append(
                (int(lane), int(self._counts[journey.ENDING, lane]), self._log[lane, :, :samples_count].copy())
            )
            self._counts[journey.ENDING, lane] = journey.IDLE
        return ended


def place_car(state: FloatArray, lane: int, *, vehicle: Vehicle, driver: Driver, stability: StabilitySystems) -> None:
    """Write a car at rest and its driver into a lane, over whatever was there.

    Args:
        state: Of all lanes.
        lane: Which one.
        vehicle: The car.
        driver: The driver.
        stability: Which of its systems work.
    """
    places = state.reshape(-1, 4, LANES)[:, :, lane]
    places[:] = 0.0
    places[: DRIVER // WHEELS] = _given(vehicle)
    places[DRIVER // WHEELS : DRIVER // WHEELS + len(driver)] = np.array(driver, dtype=np.float64)[:, None]
    abs_on, tcs_on, esc_on = stability
    for row, value in (
        (ABS_ON, abs_on),
        (TCS_ON, tcs_on),
        (ESC_ON, esc_on),
        (GRADIENT, _gradient_s2pm(vehicle)),
    ):
        places[row // WHEELS] = value
    places[LEVER_X // WHEELS] = [vehicle.front_axle_m] * 2 + [-vehicle.rear_axle_m] * 2
    front, rear = 0.5 * vehicle.front_track_m, 0.5 * vehicle.rear_track_m
    places[LEVER_Y // WHEELS] = [front, -front, rear, -rear]


def _with_room(tables: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    if tables.shape[1] >= shape[0]:
        return tables
    roomy = np.zeros((LANES, int(_SPARE * shape[0]), shape[1]))
    roomy[:, : tables.shape[1]] = tables
    return roomy


@lru_cache(maxsize=256)
def _given(vehicle: Vehicle) -> FloatArray:
    """Return the rows of a car and its tyre, for one lane. (rows, 1)"""
    return np.array([*vehicle[:-1], *vehicle.tyre], dtype=np.float64)[:, None]


@lru_cache(maxsize=256)
def _gradient_s2pm(vehicle: Vehicle) -> float:
    return understeer_gradient_s2pm(vehicle)
