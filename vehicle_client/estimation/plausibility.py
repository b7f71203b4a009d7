"""Sensors against each other: who tells of another motion than the rest, or of one that no car makes.

A car's turning is told four times: by the gyro, by the wheels left and right, by the lateral force over the speed, and
by the steering; with position fixes the map tells it too. A sensor is blamed when two others agree with each other and
not with it, or when it shows what no sensor of a moving car shows: one value bit for bit, the end of a range, a
steering wheel that turns faster than arms.

A grave contradiction is a fault, and the passage is kept back; a smaller one is a doubt that travels with the summary.
The limits lie beyond what good sensors showed in hundreds of simulated drives, slides included, and in three recorded
cars; `docs/sensors.md` has the figures.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roadgrip.order_statistics import median
from roadgrip.units import SAMPLE_RATE_HZ, SAMPLE_S
from vehicle_client.estimation.liveness import clipped_s, frozen_rows, rests
from vehicle_client.estimation.mounting import in_car_axes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

AROUND_S = 3.0
"""So much before and after the section is looked at, too."""
BLOCK_COUNT = 25
"""Means over a quarter of a second: the noise is gone, a car's turning is not."""
BLOCKS_MIN_COUNT = 12
SPEED_MIN_MPS = 3.0
TURNING_MIN_RADPS = 0.03
"""Standard deviation of the yaw rate; straighter drives do not tell who sees them turn."""
AGREEING_CORRELATION = 0.85
"""Two witnesses that agree so well are believed."""
PRESSED_PER_MPS2 = 0.001
"""How much smaller a tyre rolls at the outer side than at the inner one, per lateral acceleration."""
FORCE_MIN_MPS2 = 0.6
BEND_MPS2 = 0.3
"""Mean size of the lateral force while a channel rests at zero; less is a straight."""
FORCE_WINDOW_COUNT = 8
"""Two seconds: a lateral velocity cannot grow longer."""
CALM_MPS2 = 0.7
"""Of lateral acceleration; below it tyres hardly slip, and the wheels point where the car goes."""
STRAIGHT_1PM = 0.008
"""Tighter, and a steering that is 10 % off in scale looks like one whose zero moved."""
STEADY_RADPS = 0.02
"""Change of the yaw rate from one block to the next; quicker, and a car lags behind its wheels."""
CALM_MIN_COUNT, CALM_AFTER_COUNT, CALM_INTO_COUNT = 4, 16, 4
RESTING_COUNT = 7
"""No recorded channel rested for so many samples."""
WHEEL_APART_RATIO = 0.025
ACCEL_RANGE_MIN_MPS2, GYRO_RANGE_MIN_RADPS = 5.0, 0.5
"""Sensors of cars reach at least so far."""


class Sensor(StrEnum):
    """Who may be blamed."""

    GYRO = "gyro"
    ACCELEROMETER = "accelerometer"
    STEERING = "steering angle"
    WHEELS = "wheel speed"


class Level(NamedTuple):
    """From where on something is doubtful, and from where on grave."""

    doubtful_value: float
    grave_value: float


# How far good sensors came is in `docs/sensors.md`, remade by `bench/onboard/faults.py`.
FROZEN_S = Level(0.5, 0.5)
CLIPPED_S = Level(0.1, 0.3)
TURN_APART = Level(0.3, 0.5)
TURN_GAIN = Level(0.12, 0.35)
FORCE_APART = Level(0.2, 0.5)
FORCE_MPS2 = Level(2.2, 4.0)
STEER_STEP_RAD = Level(0.012, 0.015)
STEER_SHIFT_RAD = Level(0.008, 0.015)
STEER_HELD_RAD = Level(0.012, 0.03)
WHEEL_APART_FRAC = Level(0.3, np.inf)


@dataclass(frozen=True, slots=True)
class Finding:
    """What one check found.

    Attributes:
        sensor: Whom it blames.
        what: In words, without the number.
        found_value: How much.
        level: From where on that is doubtful, and grave.
    """

    sensor: Sensor
    what: str
    found_value: float
    level: Level

    @property
    def doubtful(self) -> bool:
        """Whether a summary should carry a flag."""
        return self.found_value >= self.level.doubtful_value

    @property
    def grave(self) -> bool:
        """Whether the passage should be kept back."""
        return self.found_value >= self.level.grave_value

    def __str__(self) -> str:
        return f"{self.sensor.value} {self.what} ({self.found_value:.2g})"


class _Blocks(NamedTuple):
    """Means over a quarter of a second, where the car is fast enough. All (k,) unless said.

    Attributes:
        number: Of the block within the rows that are looked at.
        speed_mps: Forward.
        gyro_radps: As the gyro says.
        accel_y_mps2: As the accelerometer says.
        steer_rad: As the steering says.
        wheel_mps: As each wheel says, moved to the middle of the car; without slip all are the same. (k, 4)
        told_radps: The yaw rate as others than the gyro tell it.
    """

    number: NDArray[np.int64]
    speed_mps: FloatArray
    gyro_radps: FloatArray
    accel_y_mps2: FloatArray
    steer_rad: FloatArray
    wheel_mps: FloatArray
    told_radps: dict[str, FloatArray]


def findings(
    trace: Trace, speed_mps: FloatArray, *, from_s: float, to_s: float, vehicle: VehicleGeometry
) -> tuple[Finding, ...]:
    """Return what the checks found, harmless or not, of the sensors within the car.

    Channels in `trace.absent` are asked nothing; below 3 m/s nothing is said.

    Args:
        trace: Without gaps (bridged), in the sensor's own axes: turned, one channel that froze would live by another.
        speed_mps: Forward. (n,)
        from_s: When the vehicle entered the section.
        to_s: When it left it.
        vehicle: The own car.
    """
    first, beyond = np.searchsorted(trace.time_s, [from_s - AROUND_S, to_s + AROUND_S])
    rows = slice(int(first), int(beyond))
    found = [*_lifeless(trace, speed_mps, rows)]
    trace = in_car_axes(trace, vehicle)
    blocks = _blocks(trace, speed_mps, rows, vehicle)
    if len(blocks.number) < BLOCKS_MIN_COUNT:
        return tuple(found)
    turning = tuple(_turning(blocks, track_m=vehicle.track_m))
    found += turning
    if not any(finding.doubtful for finding in turning):
        # Only a gyro that is believed is a witness against others.
        if "accel_y_mps2" not in trace.absent:
            found += _force(blocks)
        if "steer_rad" not in trace.absent:
            entered = (from_s - float(trace.time_s[first])) * SAMPLE_RATE_HZ / BLOCK_COUNT
            found += _steering(blocks, vehicle.wheelbase_m, entered_count=entered)
            found += _steering_by_itself(trace, speed_mps, rows, vehicle.wheelbase_m)
    if "wheels" in blocks.told_radps:
        middle = np.sort(blocks.wheel_mps, axis=1)[:, 1:3].mean(axis=1, keepdims=True)
        apart = np.mean(np.abs(blocks.wheel_mps - middle) > WHEEL_APART_RATIO * middle, axis=0)
        found.append(Finding(Sensor.WHEELS, "differs from the other three", float(apart.max()), WHEEL_APART_FRAC))
    return tuple(found)


def _blocks(trace: Trace, speed_mps: FloatArray, rows: slice, vehicle: VehicleGeometry) -> _Blocks:
    count = (rows.stop - rows.start) // BLOCK_COUNT
    channels = (speed_mps, trace.yaw_rate_radps, trace.accel_y_mps2, trace.steer_rad)
    rows = slice(rows.start, rows.start + count * BLOCK_COUNT)
    means = np.stack([channel[rows].reshape(count, BLOCK_COUNT).mean(axis=1) for channel in channels])
    wheels = trace.wheel_speed_mps[rows].reshape(count, BLOCK_COUNT, 4).mean(axis=1)
    number = np.flatnonzero(means[0] > SPEED_MIN_MPS)
    speed, gyro, accel_y, steer = means[:, number]
    wheels = wheels[number]
    told = {}
    along = np.cos(steer)
    if not any(name.startswith("wheel") for name in trace.absent):
        front, rear = (wheels[:, 1] - wheels[:, 0]) / along, wheels[:, 3] - wheels[:, 2]
        told["wheels"] = (front + rear) / (2.0 * vehicle.track_m)
    if "accel_y_mps2" not in trace.absent:
        told["force"] = accel_y / speed
    if "steer_rad" not in trace.absent:
        told["steering"] = speed * np.tan(steer) / vehicle.wheelbase_m
    half = gyro * (vehicle.track_m / 2.0)
    across = gyro * vehicle.front_axle_m * np.tan(steer)
    middle = np.column_stack(
        [
            wheels[:, 0] / along - across + half,
            wheels[:, 1] / along - across - half,
            wheels[:, 2] + half,
            wheels[:, 3] - half,
        ]
    )
    return _Blocks(number, speed, gyro, accel_y, steer, middle, told)


def _lifeless(trace: Trace, speed_mps: FloatArray, rows: slice) -> Iterator[Finding]:
    """Yield how long an inertial sensor shows one value bit for bit, or the end of its range, while others live."""
    names = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps")
    channels = {name: getattr(trace, name)[rows] for name in names if name not in trace.absent}
    valid = trace.valid[rows]
    if len(valid) < 2:
        return
    borders = {name: rests(values, valid) for name, values in channels.items()}
    wheels = trace.wheel_speed_mps[rows, 2]
    borders["wheel"] = rests(wheels, valid)
    for name, values in channels.items():
        sensor = Sensor.ACCELEROMETER if name.startswith("accel") else Sensor.GYRO
        frozen = frozen_rows(borders, name)
        # A coarse sensor on a straight may rest at zero; in a bend none does.
        if frozen is not None and (values[frozen.start] != 0.0 or _bending(channels, speed_mps[rows], frozen, name)):
            duration_s = (frozen.stop - frozen.start) * SAMPLE_S
            yield Finding(sensor, f"frozen for seconds ({name})", duration_s, FROZEN_S)
        if name in {"accel_y_mps2", "yaw_rate_radps"}:
            least = ACCEL_RANGE_MIN_MPS2 if sensor is Sensor.ACCELEROMETER else GYRO_RANGE_MIN_RADPS
            clipped = clipped_s(values, borders[name], least_value=least)
            yield Finding(sensor, f"at the end of its range for seconds ({name})", clipped, CLIPPED_S)


def _bending(channels: dict[str, FloatArray], speed_mps: FloatArray, rows: slice, name: str) -> bool:
    """Return whether the other of gyro and accelerometer feels a bend on the mean of some rows."""
    if name == "yaw_rate_radps" and "accel_y_mps2" in channels:
        force = channels["accel_y_mps2"][rows]
    elif name == "accel_y_mps2" and "yaw_rate_radps" in channels:
        force = channels["yaw_rate_radps"][rows] * speed_mps[rows]
    else:
        return False
    return bool(np.mean(np.abs(force)) > BEND_MPS2)


def _turning(blocks: _Blocks, *, track_m: float) -> Iterator[Finding]:
    """Yield how far the gyro is from what two others agree on, in course and in size.

    In size all must be on the same side of it: wheels behind a locked differential hardly differ, a bank takes from the
    lateral force, and a car that slides understeers.
    """
    told = {name: _winding(yaw_rate, blocks.speed_mps) for name, yaw_rate in blocks.told_radps.items()}
    gyro = _winding(blocks.gyro_radps, blocks.speed_mps)
    turning = {name: yaw_rate for name, yaw_rate in told.items() if float(np.std(yaw_rate)) > TURNING_MIN_RADPS}
    agreeing: set[str] = set()
    for one, other in combinations(turning, 2):
        if _correlation(turning[one], turning[other]) > AGREEING_CORRELATION:
            agreeing |= {one, other}
    if not agreeing:
        return
    apart = 1.0 - max(_correlation(gyro, turning[name]) for name in agreeing)
    yield Finding(Sensor.GYRO, "turns otherwise than " + " and ".join(sorted(agreeing)), apart, TURN_APART)
    if "wheels" in agreeing and apart < TURN_APART.grave_value:
        # Loaded tyres of the outer side are flatter than the inner ones, which the wheels show as turning.
        pressed = PRESSED_PER_MPS2 * float(np.mean(blocks.speed_mps**2)) / track_m
        factors = [
            (_gain_range(gyro, turning[name]), pressed if name == "wheels" else 0.0) for name in sorted(agreeing)
        ]
        too_much = min(lowest - 1.0 - allowed for (lowest, _), allowed in factors)
        too_little = min(1.0 - highest - allowed for (_, highest), allowed in factors)
        error = max(0.0, too_much, too_little)
        yield Finding(Sensor.GYRO, "turns more or less than all others tell, as a share", error, TURN_GAIN)


def _gain_range(one: FloatArray, other: FloatArray) -> tuple[float, float]:
    """Return between which factors one signal is the other's, noise in either granted; they must agree in sign."""
    product = float(one @ other)
    return product / float(other @ other), float(one @ one) / product


def _winding(yaw_rate_radps: FloatArray, speed_mps: FloatArray) -> FloatArray:
    """Return the yaw rate less a constant curvature: unequal tyres and offsets look like one."""
    return yaw_rate_radps - speed_mps * (float(speed_mps @ yaw_rate_radps) / float(speed_mps @ speed_mps))


def _correlation(one: FloatArray, other: FloatArray) -> float:
    power = float(one @ one) * float(other @ other)
    return float(one @ other) / np.sqrt(power) if power > 0.0 else 0.0


def _force(blocks: _Blocks) -> Iterator[Finding]:
    """Yield how far the lateral force is from the centripetal one, gravity's share and a growing slide aside."""
    centripetal = blocks.gyro_radps * blocks.speed_mps
    if float(np.std(centripetal)) > FORCE_MIN_MPS2:
        apart = 1.0 - _correlation(centripetal - centripetal.mean(), blocks.accel_y_mps2 - blocks.accel_y_mps2.mean())
        yield Finding(Sensor.ACCELEROMETER, "does not feel the bends", apart, FORCE_APART)
    running = np.convolve(blocks.accel_y_mps2 - centripetal, np.ones(FORCE_WINDOW_COUNT) / FORCE_WINDOW_COUNT, "valid")
    size = float(np.abs(running).max())
    yield Finding(Sensor.ACCELEROMETER, "feels a force that no bend explains, m/s2", size, FORCE_MPS2)


def _steering(blocks: _Blocks, wheelbase_m: float, *, entered_count: float) -> Iterator[Finding]:
    """Yield how far the steering's zero moved between the straight before and that after the section."""
    beyond = blocks.steer_rad - wheelbase_m * blocks.gyro_radps / blocks.speed_mps
    calm = np.abs(blocks.gyro_radps * blocks.speed_mps) < CALM_MPS2
    calm &= np.abs(blocks.gyro_radps) < STRAIGHT_1PM * blocks.speed_mps
    calm &= np.abs(np.gradient(blocks.gyro_radps)) < STEADY_RADPS
    before = calm & (blocks.number < entered_count + CALM_INTO_COUNT)
    after = calm & (blocks.number > blocks.number[-1] - CALM_AFTER_COUNT)
    if before.sum() >= CALM_MIN_COUNT and after.sum() >= CALM_MIN_COUNT:
        moved = abs(float(beyond[after].mean() - beyond[before].mean()))
        yield Finding(Sensor.STEERING, "has another zero after the section, rad", moved, STEER_SHIFT_RAD)


def _steering_by_itself(trace: Trace, speed_mps: FloatArray, rows: slice, wheelbase_m: float) -> Iterator[Finding]:
    """Yield the fastest step of the steering, and how far the car's curvature changed while it showed one value."""
    steer, valid = trace.steer_rad[rows], trace.valid[rows]
    step = np.diff(steer)
    # The step over those around it, so that quick hands are none; neighbours of a gap are left out.
    around = (step[:-4] + step[1:-3] + step[3:-1] + step[4:]) / 4.0
    alone = np.abs(step[2:-2] - around)
    fastest = int(np.argmax(alone)) + 2
    # Where the whole network repeated itself, the step only catches up.
    before = slice(max(0, fastest - RESTING_COUNT), fastest + 1)
    alive = any(np.ptp(channel[rows][before]) > 0.0 for channel in (trace.yaw_rate_radps, trace.accel_x_mps2))
    whole = alive and bool(valid[max(0, fastest - 2) : fastest + 4].all())
    stays = abs(median(steer[fastest + 1 : fastest + 4]) - median(steer[fastest - 2 : fastest + 1]))
    size = min(float(alone[fastest - 2]), stays) if whole else 0.0
    yield Finding(Sensor.STEERING, "jumps within a sample, rad", size, STEER_STEP_RAD)
    borders = rests(steer, valid)
    counts = np.diff(borders)
    held = 0.0
    for at in np.flatnonzero(counts >= 2 * BLOCK_COUNT):
        part = slice(rows.start + int(borders[at]), rows.start + int(borders[at + 1]))
        blocks = int(counts[at]) // BLOCK_COUNT
        part = slice(part.start, part.start + blocks * BLOCK_COUNT)
        curvature = trace.yaw_rate_radps[part] / np.maximum(speed_mps[part], SPEED_MIN_MPS)
        held = max(held, float(np.ptp(curvature.reshape(blocks, BLOCK_COUNT).mean(axis=1))))
    yield Finding(Sensor.STEERING, "rests while the car turns, rad", held * wheelbase_m, STEER_HELD_RAD)
