"""Whether the channels of a recording are what they are said to be: a verdict for each, and what to change."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import SAMPLE_RATE_HZ
from vehicle_client.estimation.gaps import longest_gap_s, missing_frac
from vehicle_client.recording.channels import CHANNELS, WHEEL_COLUMNS
from vehicle_client.recording.consistency import (
    COURSE,
    FORWARD,
    FRONT,
    LATERAL,
    REAR,
    SPEED,
    STEERING,
    Blocks,
    Misreading,
    Relation,
    blocks_of,
    likeliest,
    log_misfit,
    relation_between,
    relations_of,
    steering_gain_ratio,
)
from vehicle_client.recording.signal_mapping import ALL_BITS_SET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
    from vehicle_client.recording.series import SeriesCount

SLOW_HZ = 18.0
"""Values that come 20 times a second, with some jitter, are good enough (docs/decisions/0012)."""
INVALID_LIMIT_FRAC = 0.05
MISFIT_LIMIT = 0.9
"""Logarithm of a gain that no unit explains and no road does either: a factor of two and a half."""
_MISFIT_LIMITS = {SPEED: 0.2, LATERAL: 1.4}
"""Where they differ. On ice the bank of a road carries most of a curve, and an accelerometer feels a quarter of it."""
_TURNS_MPS2 = 0.8
"""Spread of lateral acceleration from which on a drive can be asked why a channel does not follow."""
_SPEED_CHANGES_MPS2 = 0.4
_FOLLOWS, _STRANGE = 0.8, 0.3
_STEERING_OK = (0.45, 2.2)
_STEERING_WHEEL = (6.0, 40.0)
_DEG = 180.0 / math.pi
_ROLL_FOLLOWS = 0.4
_ROLL_RADPS = 0.2
"""Spread of roll rate, in means of 0.2 s, that no car has for long: its springs would be at their ends."""
_CLEARLY = 0.2
_WHEEL_RATIO = (0.9, 1.1)
_MOVING_MPS = 3.0
_FAR = {
    "accel_x_mps2": 15.0,
    "accel_y_mps2": 15.0,
    "roll_rate_radps": 3.0,
    "yaw_rate_radps": 3.0,
    "steer_rad": 1.0,
} | dict.fromkeys(WHEEL_COLUMNS, 90.0)
"""No car is there on a road; one whose unit is wrong may be, but does not leap there."""
_LEAP_RATIO, _LEAP_COUNT, _USUAL_FRAC = 1.5, 5, 0.98
_TURNING = ("yaw_rate_radps", "accel_y_mps2", "steer_rad")
_SIGN_HINT = "has lost its sign: is that a signal of its own? negative_when says which"
ROLL = "roll rate against change of lateral acceleration"


class Verdict(StrEnum):
    """What is thought of a channel."""

    OK = "ok"
    OFF = "off"
    """Something must be changed; the hint says what."""
    NOT_JUDGED = "not judged"
    """This drive does not show it."""
    ABSENT = "absent"
    """The car or the recording lacks it."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What is known about one channel.

    Attributes:
        channel: One of `CHANNELS`, or `positions`.
        verdict: What is thought of it.
        hint: Why, and what to change.
        rate_hz: Values a second; NaN if absent.
        lower: Smallest value, in the channel's unit; NaN without any.
        upper: Largest.
        longest_gap_s: Longest time without a value.
        invalid_frac: Share of values that say there is none, or of samples that are missing.
    """

    channel: str
    verdict: Verdict
    hint: str
    rate_hz: float
    lower: float
    upper: float
    longest_gap_s: float
    invalid_frac: float


def inspect_trace(
    trace: Trace, vehicle: VehicleGeometry, *, counts: Mapping[str, SeriesCount] | None = None
) -> tuple[Finding, ...]:
    """Return a finding for each sensor and for the positions.

    Signs, units and sides are judged by what the channels say about each other, see
    `vehicle_client.recording.consistency`; a few minutes of driving with some curves are enough. What this drive does
    not show is not judged, and never called wrong.

    Args:
        trace: The recording.
        vehicle: The car; its wheelbase and track to a tenth.
        counts: What each channel is worth, if they came each with time stamps of its own.
    """
    blocks = blocks_of(trace)
    relations = relations_of(blocks, trace, vehicle)
    exchanged = _accelerations_exchanged(blocks, relations)
    if exchanged:
        relations = {name: relation for name, relation in relations.items() if name not in {LATERAL, FORWARD}}
    reading = likeliest(relations)
    hints = _hints(trace, vehicle, blocks, relations, reading)
    if exchanged:
        for channel in ("accel_x_mps2", "accel_y_mps2"):
            hints[channel].append("forward and lateral acceleration look exchanged: exchange the two signals")
    for channel in CHANNELS:
        if channel not in trace.absent and (code := _code_hint(channel, _values(trace, channel)[trace.valid])):
            hints[channel] = [code]
    backed = _backed(relations, reading)
    findings = []
    for channel in CHANNELS:
        if channel in trace.absent:
            nan = math.nan
            findings.append(Finding(channel, Verdict.ABSENT, "", nan, nan, nan, nan, nan))
            continue
        figures = _figures(trace, channel, None if counts is None else counts.get(channel))
        hint = "; ".join(one for one in (*_figure_hints(figures), *hints.get(channel, ())) if one)
        verdict = Verdict.OFF if hint else Verdict.OK if channel in backed else Verdict.NOT_JUDGED
        if verdict is Verdict.NOT_JUDGED:
            hint = "this drive does not show its sign and unit"
        findings.append(Finding(channel, verdict, hint, *figures))
    return (*findings, _finding_of_positions(trace, relations))


def _figures(trace: Trace, channel: str, count: SeriesCount | None) -> tuple[float, float, float, float, float]:
    if count is not None:
        return (
            1.0 / count.step_s,
            count.lower,
            count.upper,
            count.longest_gap_s,
            count.invalid_count / max(1, count.values_count),
        )
    values = _values(trace, channel)[trace.valid]
    lower, upper = (float(values.min()), float(values.max())) if len(values) else (math.nan, math.nan)
    return SAMPLE_RATE_HZ, lower, upper, longest_gap_s(trace.valid), missing_frac(trace.valid)


def _values(trace: Trace, channel: str) -> FloatArray:
    if channel in WHEEL_COLUMNS:
        return np.asarray(trace.wheel_speed_mps[:, WHEEL_COLUMNS.index(channel)])
    return np.asarray(getattr(trace, channel))


def _figure_hints(figures: tuple[float, float, float, float, float]) -> tuple[str, ...]:
    rate_hz, lower, upper, _, invalid_frac = figures
    return (
        f"only {rate_hz:.0f} values a second" if rate_hz < SLOW_HZ else "",
        f"{invalid_frac:.0%} of it is not there" if invalid_frac > INVALID_LIMIT_FRAC else "",
        "it never changes: is this the right signal?" if lower == upper else "",
    )


def _code_hint(channel: str, values: FloatArray) -> str:
    """Return what to say of a channel that leaps, within a sample, to where no car takes it."""
    if len(values) < 2:
        return ""
    sizes = np.abs(values)
    furthest = int(np.argmax(sizes))
    leaps = np.abs(np.diff(values)) > _LEAP_RATIO * max(float(np.quantile(sizes, _USUAL_FRAC)), 1e-9)
    around = leaps[max(0, furthest - _LEAP_COUNT) : furthest + _LEAP_COUNT]
    if sizes[furthest] < _FAR[channel] or not around.any():
        return ""
    return (
        f'leaps to {values[furthest]:.3g}: a number that means "not available"? say it as invalid '
        f"(perhaps {ALL_BITS_SET}), then inspect again"
    )


def _backed(relations: Mapping[str, Relation], reading: Misreading) -> set[str]:
    """Return the channels whose sign and unit a relation has confirmed."""
    fits = {
        name
        for name, relation in relations.items()
        if relation.tells and abs(log_misfit(relation, reading)) < MISFIT_LIMIT
    }
    confirmed: set[str] = set()
    for name, channels in (
        (FRONT, (*WHEEL_COLUMNS[:2], "yaw_rate_radps")),
        (REAR, (*WHEEL_COLUMNS[2:], "yaw_rate_radps")),
        (LATERAL, ("accel_y_mps2", "yaw_rate_radps", *WHEEL_COLUMNS)),
        (FORWARD, ("accel_x_mps2", *WHEEL_COLUMNS)),
        (STEERING, ("steer_rad", "yaw_rate_radps")),
        (SPEED, WHEEL_COLUMNS),
        (COURSE, ("yaw_rate_radps",)),
        (ROLL, ("roll_rate_radps",)),
    ):
        if name in fits:
            confirmed |= set(channels)
    return confirmed


def _hints(
    trace: Trace,
    vehicle: VehicleGeometry,
    blocks: Blocks,
    relations: dict[str, Relation],
    reading: Misreading,
) -> dict[str, list[str]]:
    """Return what is wrong, by channel; also adds the relation of the roll rate."""
    hints: dict[str, list[str]] = {channel: [] for channel in CHANNELS}
    if not len(blocks.time_s) or float(np.median(blocks.speed_mps)) / reading.wheels_gain < _MOVING_MPS:
        relations.clear()
        return hints
    _wheel_hints(hints, blocks, reading)
    if reading.yaw_turned:
        hints["yaw_rate_radps"].append("turned round: gain = -1")
    if reading.yaw_unit:
        hints["yaw_rate_radps"].append(f'looks like {reading.yaw_unit}: unit = "{reading.yaw_unit}"')
    _acceleration_hints(hints, reading)
    if reading.steer_turned:
        hints["steer_rad"].append("turned round: gain = -1")
    if STEERING in relations and relations[STEERING].tells:
        hints["steer_rad"].append(_steering_hint(abs(steering_gain_ratio(blocks, vehicle, reading))))
    _misfit_hints(hints, relations, reading)
    _stranger_hints(hints, blocks, relations, reading)
    # Which of the two is turned round could not be said of a lateral acceleration that nothing else confirms.
    if "roll_rate_radps" not in trace.absent and LATERAL in relations and relations[LATERAL].tells:
        relations[ROLL], hint = _roll(blocks, reading)
        hints["roll_rate_radps"].append(hint)
    return hints


def _wheel_hints(hints: dict[str, list[str]], blocks: Blocks, reading: Misreading) -> None:
    if reading.wheels_unit:
        for name in WHEEL_COLUMNS:
            hints[name].append(f'wheel speeds look like {reading.wheels_unit}: unit = "{reading.wheels_unit}"')
    for swapped, names, axle in (
        (reading.front_swapped, WHEEL_COLUMNS[:2], "front"),
        (reading.rear_swapped, WHEEL_COLUMNS[2:], "rear"),
    ):
        for name in names if swapped else ():
            hints[name].append(f"left and right are exchanged at the {axle}: exchange the two signals")
    usual = np.median([blocks.columns[name] for name in WHEEL_COLUMNS], axis=0)
    for name in WHEEL_COLUMNS:
        ratio = float(np.median(blocks.columns[name][usual > 0.0] / usual[usual > 0.0])) if (usual > 0.0).any() else 0.0
        if not _WHEEL_RATIO[0] < ratio < _WHEEL_RATIO[1]:
            hints[name].append(f"{ratio:.2f} times the other wheels: is this the right signal?")


def _acceleration_hints(hints: dict[str, list[str]], reading: Misreading) -> None:
    for channel, axis, turned, unit in (
        ("accel_y_mps2", "lateral", reading.accel_y_turned, reading.accel_y_unit),
        ("accel_x_mps2", "forward", reading.accel_x_turned, reading.accel_x_unit),
    ):
        if turned:
            hints[channel].append(f"{axis} axis is turned round: gain = -1")
        if unit:
            hints[channel].append(f'looks like {unit}: unit = "{unit}"')


def _steering_hint(gain_ratio: float) -> str:
    low, high = _STEERING_WHEEL
    if _STEERING_OK[0] <= gain_ratio <= _STEERING_OK[1]:
        return ""
    if low <= gain_ratio <= high:
        return f"looks like the steering wheel's angle: steering_ratio = {gain_ratio:.1f}, about"
    if low * _DEG < gain_ratio <= high * _DEG:
        ratio = gain_ratio / _DEG
        return f'looks like the steering wheel\'s angle in degrees: unit = "deg", steering_ratio = {ratio:.1f}, about'
    if _STEERING_OK[0] * _DEG <= gain_ratio <= _STEERING_OK[1] * _DEG:
        return 'looks like degrees: unit = "deg"'
    return f"{gain_ratio:.2g} times what the curves ask for: check unit and steering_ratio"


def _misfit_hints(hints: dict[str, list[str]], relations: Mapping[str, Relation], reading: Misreading) -> None:
    for name, channel, what in (
        (LATERAL, "accel_y_mps2", "speed times yaw rate"),
        (FORWARD, "accel_x_mps2", "the change of speed"),
        (SPEED, WHEEL_COLUMNS[0], "the speed of the positions"),
    ):
        relation = relations.get(name)
        if relation is None or abs(relation.correlation_ratio) < _FOLLOWS:
            continue
        misfit = log_misfit(relation, reading)
        if abs(misfit) > _MISFIT_LIMITS.get(name, MISFIT_LIMIT):
            channels = WHEEL_COLUMNS if name is SPEED else (channel,)
            for one in channels:
                hints[one].append(f"{math.exp(misfit):.2g} times {what}: check unit and gain")


def _stranger_hints(
    hints: dict[str, list[str]], blocks: Blocks, relations: Mapping[str, Relation], reading: Misreading
) -> None:
    """Add the channels that go with nothing in a drive that gives them every reason to."""
    of = blocks.columns
    speed = blocks.speed_mps / reading.wheels_gain
    lateral, steering, forward = (relations.get(name) for name in (LATERAL, STEERING, FORWARD))
    signless = [channel for channel in _TURNING if _sign_is_lost(channel, of)]
    for channel in signless:
        hints[channel].append(_SIGN_HINT)
    if lateral and steering and not signless:
        weak = {
            channel
            for channel, relation in (("accel_y_mps2", lateral), ("steer_rad", steering))
            if abs(relation.correlation_ratio) < _STRANGE
        }
        by_yaw = float(np.std(speed * of["yaw_rate_radps"] / reading.yaw_gain)) > _TURNS_MPS2
        by_accel = float(np.std(of["accel_y_mps2"] / reading.accel_y_gain)) > _TURNS_MPS2
        curve = relation_between("", of["accel_y_mps2"], speed**2 * of["steer_rad"], tolerance_ratio=1.0)
        if len(weak) == 2 and by_accel and abs(curve.correlation_ratio) > _FOLLOWS:
            hints["yaw_rate_radps"].append("does not go with steering and lateral acceleration: is it another axis?")
        elif len(weak) == 1 and by_yaw:
            hints[weak.pop()].append("does not go with the yaw rate: is this the right signal?")
    changes = float(np.std(np.mean([blocks.slopes[name] for name in WHEEL_COLUMNS], axis=0))) / reading.wheels_gain
    if forward and changes > _SPEED_CHANGES_MPS2 and abs(forward.correlation_ratio) < _STRANGE:
        hints["accel_x_mps2"].append("does not go with the change of speed: is this the right signal?")


def _sign_is_lost(channel: str, columns: Mapping[str, FloatArray]) -> bool:
    """Return whether a channel shows both turns as one, and is else what another channel shows to both sides."""
    values = columns[channel]
    if (values > 0.0).any() and (values < 0.0).any():
        return False
    for other in _TURNING:
        turns = columns[other]
        if min(float(turns.max()), -float(turns.min())) < float(np.std(turns)) / 2.0:
            continue
        signed = relation_between("", values, turns, tolerance_ratio=1.0)
        sizes = relation_between("", np.abs(values), np.abs(turns), tolerance_ratio=1.0)
        if abs(sizes.correlation_ratio) > _FOLLOWS > abs(signed.correlation_ratio):
            return True
    return False


def _accelerations_exchanged(blocks: Blocks, relations: Mapping[str, Relation]) -> bool:
    """Return whether the forward acceleration is what the lateral one should be, and the other way round."""
    if LATERAL not in relations or FORWARD not in relations:
        return False
    of, speed = blocks.columns, blocks.speed_mps
    slope = np.mean([blocks.slopes[name] for name in WHEEL_COLUMNS], axis=0)
    as_lateral = relation_between("", of["accel_x_mps2"], speed * of["yaw_rate_radps"], tolerance_ratio=1.0)
    as_forward = relation_between("", of["accel_y_mps2"], np.asarray(slope), tolerance_ratio=1.0)
    return (
        abs(as_lateral.correlation_ratio) > abs(relations[LATERAL].correlation_ratio) + _CLEARLY
        and abs(as_forward.correlation_ratio) > abs(relations[FORWARD].correlation_ratio) + _CLEARLY
    )


def _roll(blocks: Blocks, reading: Misreading) -> tuple[Relation, str]:
    """Return how roll goes with lateral acceleration, and what is wrong with it.

    A body leans out of its curve; the bank of the road leans it in, more slowly. What changes within a second is the
    body's own.
    """
    accel = _quick(blocks.slopes["accel_y_mps2"] / reading.accel_y_gain)
    roll = blocks.columns["roll_rate_radps"]
    found = relation_between(ROLL, _quick(roll), accel, tolerance_ratio=1.0)
    hints = []
    if abs(found.correlation_ratio) >= _ROLL_FOLLOWS and found.gain < 0.0:
        hints.append("turned round: gain = -1")
    if float(np.std(roll)) > _ROLL_RADPS:
        hints.append('looks like deg/s: unit = "deg/s"')
    return found, "; ".join(hints)


def _quick(values: FloatArray) -> FloatArray:
    """Return what changes within a second, the mean of five blocks taken away. (n - 4,)"""
    around = np.convolve(values, np.full(5, 0.2), mode="valid") if len(values) >= 5 else np.zeros(0)
    return values[2:-2] - around if len(values) >= 5 else around


def _finding_of_positions(trace: Trace, relations: Mapping[str, Relation]) -> Finding:
    gnss = trace.gnss
    nan = math.nan
    if gnss is None:
        return Finding("positions", Verdict.ABSENT, "", nan, nan, nan, nan, nan)
    steps = np.diff(np.sort(gnss.time_s))
    rate_hz = 1.0 / float(np.median(steps)) if len(steps) and np.median(steps) > 0.0 else nan
    gap_s = float(steps.max()) if len(steps) else nan
    judged = COURSE in relations and relations[COURSE].tells
    hint = "" if judged else "too few of them, or no curve, to judge them by"
    return Finding("positions", Verdict.OK if judged else Verdict.NOT_JUDGED, hint, rate_hz, nan, nan, gap_s, 0.0)
