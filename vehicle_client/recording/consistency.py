"""What the channels of one drive say about each other: signs and units that explain them all at once.

A car that turns shows it five times: in its yaw rate, in the difference of its front and of its rear wheels, in its
lateral acceleration and in its steering; one that has a receiver shows it a sixth time, in its course. Each pair is one
relation with a known gain. A channel that is turned round or comes in another unit breaks all its relations and no
other; so of all ways to misread the channels, the likeliest is the one that explains every gain with the fewest
misreadings. Two misreadings that nothing can tell apart (all channels mirrored, without a receiver) stay unseen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.order_statistics import median
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from vehicle_client.recording.channels import SENSOR_COLUMNS, WHEEL_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

BLOCK_COUNT = 20
"""Samples that are averaged: 0.2 s is long beside noise and short beside a curve."""
_EARTH_M = 6_371_000.0
_COURSE_S = 2.0
_CORRELATION_MIN = 0.4
"""Below it a relation says nothing."""
_DEG = 180.0 / math.pi
_UNDERSTEER_S2PM = 0.002
"""Radians of steering per m/s2 of lateral acceleration that a usual car asks for beyond the curve's angle."""

_COST_OF_MISREADING = 4.0
_COST_OF_SIGN = 30.0
"""A wrong sign is as unlikely as any misfit can get: a relation that fits nothing shall not outvote the others."""

FRONT = "front wheels against yaw rate"
REAR = "rear wheels against yaw rate"
LATERAL = "lateral acceleration against speed and yaw rate"
FORWARD = "forward acceleration against change of speed"
STEERING = "steering against yaw rate"
SPEED = "wheels against positions"
COURSE = "yaw rate against positions"

WHEEL_UNITS = {"": 1.0, "km/h": 3.6, "mph": 2.237, "rpm": 60.0 / (2.0 * math.pi * 0.33)}
ACCELERATION_UNITS = {"": 1.0, "g": 1.0 / GRAVITY_MPS2}
RATE_UNITS = {"": 1.0, "deg/s": _DEG}


@dataclass(frozen=True, slots=True)
class Relation:
    """How one quantity goes with another in a drive.

    Attributes:
        name: Which two.
        gain: Slope; 1 if all channels are what they should be.
        correlation_ratio: How closely; -1 to 1.
        tolerance_ratio: How far its logarithm may lie from that of what it should be, one standard deviation.
    """

    name: str
    gain: float
    correlation_ratio: float
    tolerance_ratio: float

    @property
    def tells(self) -> bool:
        """Whether it says anything."""
        return abs(self.correlation_ratio) >= _CORRELATION_MIN and self.gain != 0.0


@dataclass(frozen=True, slots=True)
class Misreading:
    """Which channels would have to be misread to explain a drive; nothing if all is well.

    Attributes:
        wheels_unit: Unit the wheel speeds look like; empty if m/s.
        front_swapped: Whether left and right of the front wheels are exchanged.
        rear_swapped: The same at the rear.
        yaw_unit: Unit of the yaw rate; empty if rad/s.
        yaw_turned: Whether its sign is.
        accel_y_unit: Unit of the lateral acceleration; empty if m/s2.
        accel_y_turned: Whether its sign is.
        accel_x_unit: The same, forward.
        accel_x_turned: The same, forward.
        steer_turned: Whether the sign of the steering is.
    """

    wheels_unit: str = ""
    front_swapped: bool = False
    rear_swapped: bool = False
    yaw_unit: str = ""
    yaw_turned: bool = False
    accel_y_unit: str = ""
    accel_y_turned: bool = False
    accel_x_unit: str = ""
    accel_x_turned: bool = False
    steer_turned: bool = False

    @property
    def count(self) -> int:
        """How many channels it takes to be misread."""
        return sum(
            bool(one)
            for one in (
                self.wheels_unit,
                self.front_swapped,
                self.rear_swapped,
                self.yaw_unit,
                self.yaw_turned,
                self.accel_y_unit,
                self.accel_y_turned,
                self.accel_x_unit,
                self.accel_x_turned,
                self.steer_turned,
            )
        )

    @property
    def wheels_gain(self) -> float:
        """Of the wheel speeds against m/s."""
        return WHEEL_UNITS[self.wheels_unit]

    @property
    def yaw_gain(self) -> float:
        """Of the yaw rate against rad/s to the left."""
        return RATE_UNITS[self.yaw_unit] * (-1.0 if self.yaw_turned else 1.0)

    @property
    def accel_y_gain(self) -> float:
        """Of the lateral acceleration against m/s2 to the left."""
        return ACCELERATION_UNITS[self.accel_y_unit] * (-1.0 if self.accel_y_turned else 1.0)

    @property
    def accel_x_gain(self) -> float:
        """Of the forward acceleration against m/s2 forward."""
        return ACCELERATION_UNITS[self.accel_x_unit] * (-1.0 if self.accel_x_turned else 1.0)

    def expected_gains(self) -> dict[str, float]:
        """Return the gain of each relation that it would bring about; of the steering only the sign counts."""
        wheels, yaw = self.wheels_gain, self.yaw_gain
        return {
            FRONT: (-wheels if self.front_swapped else wheels) / yaw,
            REAR: (-wheels if self.rear_swapped else wheels) / yaw,
            LATERAL: self.accel_y_gain / (wheels * yaw),
            FORWARD: self.accel_x_gain / wheels,
            STEERING: (-1.0 if self.steer_turned else 1.0) * math.copysign(1.0, yaw),
            SPEED: wheels,
            COURSE: yaw,
        }


def likeliest(relations: Mapping[str, Relation]) -> Misreading:
    """Return the fewest misreadings that explain the gains of a drive.

    Args:
        relations: By name; those that say nothing are left out of account.
    """
    told = [relation for relation in relations.values() if relation.tells]
    return min(_readings(), key=lambda reading: _cost(reading, told))


def log_misfit(relation: Relation, reading: Misreading) -> float:
    """Return by how much the logarithm of a gain misses what a reading explains; positive if the gain is larger.

    Zero for the steering, whose gain holds its ratio, and for relations that are not of a reading's.
    """
    expected = reading.expected_gains().get(relation.name)
    if relation.name == STEERING or expected is None:
        return 0.0
    return math.log(abs(relation.gain / expected))


def _readings() -> Iterator[Misreading]:
    turned = (False, True)
    for combination in product(
        *(WHEEL_UNITS, turned, turned, RATE_UNITS, turned),
        *(ACCELERATION_UNITS, turned, ACCELERATION_UNITS, turned, turned),
    ):
        yield Misreading(*combination)


def _cost(reading: Misreading, told: list[Relation]) -> float:
    cost = _COST_OF_MISREADING * reading.count
    expected = reading.expected_gains()
    for relation in told:
        if relation.gain * expected[relation.name] < 0.0:
            cost += _COST_OF_SIGN
        cost += min((log_misfit(relation, reading) / relation.tolerance_ratio) ** 2, _COST_OF_SIGN)
    return cost


@dataclass(frozen=True, slots=True)
class Blocks:
    """A drive in means of 0.2 s, without those that have holes.

    Attributes:
        time_s: Middle of each. (n,)
        columns: Mean of each channel, in whatever unit it came. Each (n,)
        slopes: Change of each channel per second. Each (n,)
    """

    time_s: FloatArray
    columns: Mapping[str, FloatArray]
    slopes: Mapping[str, FloatArray]

    @property
    def speed_mps(self) -> FloatArray:
        """Mean of the four wheels."""
        return np.asarray(np.mean([self.columns[name] for name in WHEEL_COLUMNS], axis=0))


def blocks_of(trace: Trace) -> Blocks:
    """Return a drive in means of 0.2 s; at least five of them, or none."""
    count = trace.samples_count // BLOCK_COUNT
    valid: BoolArray = np.asarray(trace.valid[: count * BLOCK_COUNT].reshape(count, BLOCK_COUNT).all(axis=1))
    channels = {name: getattr(trace, name) for name in SENSOR_COLUMNS}
    channels |= {name: trace.wheel_speed_mps[:, i] for i, name in enumerate(WHEEL_COLUMNS)}
    means = {
        name: values[: count * BLOCK_COUNT].reshape(count, BLOCK_COUNT).mean(axis=1)
        for name, values in channels.items()
    }
    step_s = BLOCK_COUNT * SAMPLE_S
    whole = valid.copy()
    whole[1:-1] &= valid[:-2] & valid[2:]
    whole[:1] = whole[-1:] = False
    if whole.sum() < 5:
        return Blocks(np.zeros(0), dict.fromkeys(channels, np.zeros(0)), dict.fromkeys(channels, np.zeros(0)))
    slopes = {name: np.gradient(values, step_s) for name, values in means.items()}
    time_s = trace.time_s[0] + step_s * (np.arange(count) + 0.5)
    moving = np.mean([np.abs(means[name]) for name in WHEEL_COLUMNS], axis=0)
    whole &= moving > 0.2 * float(moving[whole].max())
    return Blocks(
        time_s[whole],
        {name: values[whole] for name, values in means.items()},
        {name: values[whole] for name, values in slopes.items()},
    )


def relations_of(blocks: Blocks, trace: Trace, vehicle: VehicleGeometry) -> dict[str, Relation]:
    """Return how the channels of a drive go with each other, by name; channels that the car lacks are left out.

    Args:
        blocks: Of the trace.
        trace: The drive, for its positions and what it lacks.
        vehicle: The car.
    """
    if not len(blocks.time_s):
        return {}
    of, speed = blocks.columns, blocks.speed_mps
    yaw = of["yaw_rate_radps"]
    safe = np.where(np.abs(speed) > 0.0, speed, np.inf)
    wheels = (*WHEEL_COLUMNS, "yaw_rate_radps")
    pairs = (
        (FRONT, wheels, (of[WHEEL_COLUMNS[1]] - of[WHEEL_COLUMNS[0]]) / vehicle.track_m, yaw, 0.25),
        (REAR, wheels, (of[WHEEL_COLUMNS[3]] - of[WHEEL_COLUMNS[2]]) / vehicle.track_m, yaw, 0.25),
        (LATERAL, ("accel_y_mps2", "yaw_rate_radps"), of["accel_y_mps2"], speed * yaw, 0.4),
        (FORWARD, ("accel_x_mps2",), of["accel_x_mps2"], _mean_slope(blocks), 0.4),
        (STEERING, ("steer_rad", "yaw_rate_radps"), of["steer_rad"], vehicle.wheelbase_m * yaw / safe, 0.4),
    )
    found = {
        name: relation_between(name, y, x, tolerance_ratio=tolerance)
        for name, channels, y, x, tolerance in pairs
        if not set(channels) & set(trace.absent)
    }
    return found | _relations_to_positions(blocks, trace)


def steering_gain_ratio(blocks: Blocks, vehicle: VehicleGeometry, reading: Misreading) -> float:
    """Return how many times as large as the front wheels' angle the steering is.

    The wheels' angle is that of the curve and as much more as the car understeers. How much that is, the drive says
    only if it was driven at several speeds; else it is taken for that of a usual car.

    Args:
        blocks: Of the drive.
        vehicle: The car.
        reading: What the other channels are misread by.
    """
    yaw = blocks.columns["yaw_rate_radps"] / reading.yaw_gain
    speed = blocks.speed_mps / reading.wheels_gain
    steer = blocks.columns["steer_rad"] - blocks.columns["steer_rad"].mean()
    spread = float(np.mean(steer**2))
    best, best_cost = 0.0, math.inf
    for gradient in np.linspace(0.0, 3.0 * _UNDERSTEER_S2PM, 31):
        angle = vehicle.wheelbase_m * yaw / np.where(speed > 0.0, speed, np.inf) + gradient * speed * yaw
        angle -= angle.mean()
        gain = float(np.mean(angle * steer) / max(float(np.mean(angle**2)), 1e-12))
        unexplained = float(np.mean((steer - gain * angle) ** 2)) / max(spread, 1e-12)
        cost = unexplained + 0.01 * ((gradient - _UNDERSTEER_S2PM) / _UNDERSTEER_S2PM) ** 2
        if cost < best_cost:
            best, best_cost = gain, cost
    return best


def _mean_slope(blocks: Blocks) -> FloatArray:
    return np.asarray(np.mean([blocks.slopes[name] for name in WHEEL_COLUMNS], axis=0))


def relation_between(name: str, y: FloatArray, x: FloatArray, *, tolerance_ratio: float) -> Relation:
    """Return how one quantity goes with another, both free of a constant.

    The slope is that of least squares: what stands on the right of every relation is the less noisy side.
    """
    if len(x) < 5:
        return Relation(name, 0.0, 0.0, tolerance_ratio)
    dx, dy = x - x.mean(), y - y.mean()
    spread_x, spread_y = float(np.sqrt(np.mean(dx**2))), float(np.sqrt(np.mean(dy**2)))
    if spread_x < 1e-9 or spread_y < 1e-9:
        return Relation(name, 0.0, 0.0, tolerance_ratio)
    correlation = float(np.mean(dx * dy)) / (spread_x * spread_y)
    return Relation(name, correlation * spread_y / spread_x, correlation, tolerance_ratio)


def _relations_to_positions(blocks: Blocks, trace: Trace) -> dict[str, Relation]:
    gnss = trace.gnss
    if gnss is None or len(gnss.time_s) < 5:
        return {}
    order = np.argsort(gnss.time_s)
    at_s, lat_rad, lon_rad = gnss.time_s[order], np.deg2rad(gnss.lat_deg[order]), np.deg2rad(gnss.lon_deg[order])
    north = _EARTH_M * (lat_rad - lat_rad[0])
    east = _EARTH_M * (lon_rad - lon_rad[0]) * np.cos(lat_rad[0])
    time_s = blocks.time_s[(blocks.time_s > at_s[0] + _COURSE_S) & (blocks.time_s < at_s[-1] - _COURSE_S)]
    if len(time_s) < 5:
        return {}
    back, here, ahead = (
        np.column_stack([np.interp(t, at_s, east), np.interp(t, at_s, north)])
        for t in (time_s - _COURSE_S, time_s, time_s + _COURSE_S)
    )
    before, after = here - back, ahead - here
    turned = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
    driven = np.hypot(*before.T) + np.hypot(*after.T)

    def mean_over(values: FloatArray) -> FloatArray:
        """The mean over the same four seconds, weighed as a difference of two chords weighs it."""
        dense = np.interp(trace.time_s, blocks.time_s, values)
        summed = np.concatenate([[0.0], np.cumsum(np.cumsum(dense))]) * SAMPLE_S**2
        edges = np.append(trace.time_s, trace.time_s[-1] + SAMPLE_S)
        early, middle, late = (np.interp(t, edges, summed) for t in (time_s - _COURSE_S, time_s, time_s + _COURSE_S))
        return np.asarray((late - 2.0 * middle + early) / _COURSE_S**2)

    found = {
        SPEED: _through_zero(SPEED, mean_over(blocks.speed_mps), driven / (2.0 * _COURSE_S), tolerance_ratio=0.1),
    }
    if "yaw_rate_radps" not in trace.absent:
        yaw = mean_over(blocks.columns["yaw_rate_radps"])
        found[COURSE] = relation_between(COURSE, yaw, turned / _COURSE_S, tolerance_ratio=0.3)
    return found


def _through_zero(name: str, y: FloatArray, x: FloatArray, *, tolerance_ratio: float) -> Relation:
    """Return how a quantity that is never negative goes with another of the kind: their zeros are the same."""
    gain = median(y) / median(x) if median(x) > 0.0 else 0.0
    return Relation(name, gain, 1.0 if gain else 0.0, tolerance_ratio)
