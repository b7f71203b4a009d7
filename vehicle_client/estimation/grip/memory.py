"""What a car remembers of itself from passage to passage: errors of its sensors, and what its tyres and masses are.

One passage cannot tell a soft tyre from a slippery road, nor an accelerometer's offset from a map's wrong bank; many
passages on many roads can. The memory is a Gaussian over a dozen constants: small, of fixed size, easy to keep in a
file. Every passage adds its lesson (`lesson`); between passages the memory fades a little, for tyres wear, loads change
and offsets wander, but never beyond what was declared at first. A passage that contradicts it all counts little.

References:
    Anderson and Moore, Optimal Filtering, section 6.3 (information filter). Huber and Ronchetti, Robust Statistics,
    section 7.8 (bounded influence).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from roadgrip.errors import ConfigurationError

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.noise import GripNoise
    from vehicle_client.estimation.handling import Handling

FORMAT = 1
SURPRISE_LIMIT = 25.0
"""Squared distance, in standard deviations, that one lesson may move the memory; if it asks for more it counts less."""
FARTHEST = 4.0
"""No constant is thought to lie more of its first deviations away from what was declared."""
MAP_LEVEL_STD_MPS2 = 0.065
"""How well turning and the map's bank tell the mean lateral force: a map's bank is right within 0.3 degrees."""
SPEED_SCALE_STD_RATIO = 0.003
"""Of the speed, by which the turning rate's scale is known no better."""
COUPLING_STD_MPS2 = 0.02
"""What the forward force hides beside its sensor's offset."""
FACTOR_RANGE = (0.6, 1.6)
"""No memory makes a car more different than that from what was declared."""


@dataclass(frozen=True, slots=True)
class Constant:
    """One constant that a car can learn of itself.

    Attributes:
        name: With its unit; factors of declared constants are told by their logarithm.
        drift_std: How far it wanders from one passage to the next.
        handling: Which constants of `Handling` it multiplies; dotted within the tyre.
    """

    name: str
    drift_std: float
    handling: tuple[str, ...] = ()


CONSTANTS: tuple[Constant, ...] = (
    Constant("steer_offset_rad", 5e-5),
    Constant("yaw_rate_scale_ratio", 2e-4),
    Constant("accel_y_offset_mps2", 4e-3),
    Constant("accel_y_scale_ratio", 2e-4),
    Constant("accel_x_offset_mps2", 4e-3),
    Constant("front_radius_ratio", 1e-4),
    Constant("stiffness_log_ratio", 2e-3, ("tyre.stiffness_ratio", "tyre.stiffness_twice_ratio")),
    Constant("peak_slip_log_ratio", 2e-3, ("tyre.peak_slip_ratio", "tyre.peak_slip_twice_ratio")),
    Constant("along_stiffness_log_ratio", 2e-3, ("tyre.along_stiffness_ratio",)),
    Constant("yaw_inertia_log_ratio", 2e-3, ("yaw_inertia_kgm2",)),
    Constant("compliance_log_ratio", 1e-3, ("steer_compliance_radpn",)),
    Constant("front_drive_log_ratio", 1e-3, ("front_drive_frac",)),
)
"""In the order of all vectors and matrices here."""
PLACES = {constant.name: place for place, constant in enumerate(CONSTANTS)}
COUNT = len(CONSTANTS)
AUTOMOTIVE_STDS = (1.0e-3, 0.0105, 0.105, 0.0105, 0.105, 2.0e-3)
"""What is declared of a production car's sensors, in the order of `CONSTANTS`: their amplitudes, tilt included."""
IDEAL_STDS = (1.0e-4, 5.0e-4, 3.0e-3, 5.0e-4, 3.0e-3, 3.0e-5)
"""Of exact sensors."""


@dataclass(frozen=True, slots=True)
class CarMemory:
    """What a car knows of itself.

    Attributes:
        mean: Of each constant. (COUNT)
        covariance: Of all of them. (COUNT, COUNT)
        first_std: What was declared before the first passage; the memory never fades beyond. (COUNT)
        passages_count: From how many passages it was learned.
    """

    mean: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    first_std: tuple[float, ...]
    passages_count: int = 0

    def value(self, name: str) -> float:
        """Return what a constant is thought to be."""
        return self.mean[PLACES[name]]

    def std(self, name: str) -> float:
        """Return how well a constant is known."""
        place = PLACES[name]
        return math.sqrt(self.covariance[place][place])


@dataclass(frozen=True, slots=True)
class Lesson:
    """What one passage says of the constants: a quadratic about the memory that the passage was seen with.

    Attributes:
        information: Second derivatives of the misfit. (COUNT, COUNT)
        pull: How steeply the fit improves from that memory on. (COUNT,)
    """

    information: FloatArray
    pull: FloatArray


def new_memory(*, handling_std_ratio: float, sensor_stds: tuple[float, ...] = AUTOMOTIVE_STDS) -> CarMemory:
    """Return the memory of a car that has not been driven.

    Args:
        handling_std_ratio: How well masses, springs and tyres are declared.
        sensor_stds: How large the errors of its sensors may be, in the order of `CONSTANTS`.
    """
    stds = (*sensor_stds, *(handling_std_ratio for constant in CONSTANTS if constant.handling))
    return _memory(np.zeros(COUNT), np.diag(np.square(stds)), stds, passages_count=0)


def remembered(memory: CarMemory, lesson: Lesson) -> CarMemory:
    """Return the memory after one more passage.

    Args:
        memory: That the passage was seen with.
        lesson: What the passage says.
    """
    before = _faded(memory)
    # In units of what was declared at first: angles and forces differ by orders of magnitude.
    unit = np.array(memory.first_std)
    prior = np.linalg.inv(before / np.outer(unit, unit))
    information, pull = lesson.information * np.outer(unit, unit), lesson.pull * unit
    step = np.linalg.solve(prior + information, pull)
    # The less a lesson is trusted the smaller its step; without any trust there is none.
    while (surprise := float(step @ prior @ step)) > SURPRISE_LIMIT:
        trust = min(0.7, SURPRISE_LIMIT / surprise)
        information, pull = trust * information, trust * pull
        step = np.linalg.solve(prior + information, pull)
    covariance: FloatArray = np.asarray(np.linalg.inv(prior + information), dtype=np.float64) * np.outer(unit, unit)
    mean = np.asarray(np.clip(np.array(memory.mean) + step * unit, -FARTHEST * unit, FARTHEST * unit), np.float64)
    return _memory(mean, covariance, memory.first_std, passages_count=memory.passages_count + 1)


def handling_with(handling: Handling, memory: CarMemory) -> Handling:
    """Return the declared constants as the car has come to know them.

    Args:
        handling: As declared.
        memory: Of the car.
    """
    for constant, log_ratio in zip(CONSTANTS, memory.mean, strict=True):
        if constant.handling:
            handling = scaled_handling(handling, constant, log_ratio)
    return handling


def scaled_handling(handling: Handling, constant: Constant, log_ratio: float) -> Handling:
    """Return declared constants with those of one remembered constant multiplied.

    Args:
        handling: The constants.
        constant: Which one.
        log_ratio: Logarithm of the factor, which is kept within `FACTOR_RANGE`; shares stay shares.
    """
    factor = min(max(math.exp(log_ratio), FACTOR_RANGE[0]), FACTOR_RANGE[1])
    for name in constant.handling:
        of_tyre = name.removeprefix("tyre.")
        if of_tyre != name:
            tyre = replace(handling.tyre, **{of_tyre: factor * getattr(handling.tyre, of_tyre)})
            handling = replace(handling, tyre=tyre)
            continue
        value = factor * getattr(handling, name)
        handling = replace(handling, **{name: min(1.0, value) if name.endswith("_frac") else value})
    return handling


def noise_with(noise: GripNoise, memory: CarMemory, *, approach_steer_std_rad: float) -> GripNoise:
    """Return how far the sensors are trusted once what is remembered was taken out: never less than declared.

    The accelerometer is drawn to turning and map by as much as they know better what the mean force is.

    Args:
        noise: As declared.
        memory: Of the car.
        approach_steer_std_rad: How well the approach told the steering's offset by itself.
    """
    accel_std = memory.std("accel_y_offset_mps2")
    return replace(
        noise,
        steer_offset_rad=min(noise.steer_offset_rad, _parallel(memory.std("steer_offset_rad"), approach_steer_std_rad)),
        yaw_rate_scale_ratio=min(
            noise.yaw_rate_scale_ratio, math.hypot(memory.std("yaw_rate_scale_ratio"), SPEED_SCALE_STD_RATIO)
        ),
        force_y_offset_mps2=min(noise.force_y_offset_mps2, _parallel(accel_std, MAP_LEVEL_STD_MPS2)),
        force_x_offset_mps2=min(
            noise.force_x_offset_mps2, math.hypot(memory.std("accel_x_offset_mps2"), COUPLING_STD_MPS2)
        ),
        radius_ratio=min(noise.radius_ratio, memory.std("front_radius_ratio")),
        stiffness_ratio=math.hypot(noise.stiffness_ratio, memory.std("stiffness_log_ratio")),
        level_gain_ratio=min(noise.level_gain_ratio, accel_std**2 / (accel_std**2 + MAP_LEVEL_STD_MPS2**2)),
    )


def memory_to_json(memory: CarMemory) -> str:
    """Return a memory as text; `memory_of_json` gives the very same one back."""
    document = {
        "format": FORMAT,
        "passages_count": memory.passages_count,
        "constants": [constant.name for constant in CONSTANTS],
        "mean": memory.mean,
        "first_std": memory.first_std,
        "covariance": memory.covariance,
    }
    return json.dumps(document, indent=1)


def memory_of_json(text: str) -> CarMemory:
    """Return the memory that a text holds.

    Raises:
        ConfigurationError: It is none, or one of other constants, or no Gaussian.
    """
    try:
        document: dict[str, Any] = json.loads(text)
        same = (document["format"], document["constants"]) == (FORMAT, [constant.name for constant in CONSTANTS])
        mean, first = np.array(document["mean"], dtype=float), np.array(document["first_std"], dtype=float)
        covariance = np.array(document["covariance"], dtype=float)
        passages_count = int(document["passages_count"])
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise ConfigurationError(f"no memory of a car: {error}") from error
    if not same:
        raise ConfigurationError("a memory of other constants than those that a car learns now")
    shapes = (mean.shape, first.shape, covariance.shape)
    if shapes != ((COUNT,), (COUNT,), (COUNT, COUNT)) or passages_count < 0 or not bool((first > 0.0).all()):
        raise ConfigurationError("a memory with constants missing")
    scaled = covariance / np.outer(first, first)
    sound = bool(np.isfinite(mean).all() and np.isfinite(covariance).all() and np.allclose(scaled, scaled.T))
    if not sound or float(np.linalg.eigvalsh(scaled)[0]) <= 0.0:
        raise ConfigurationError("a memory whose covariance is none")
    return _memory(mean, covariance, tuple(first.tolist()), passages_count=passages_count)


def _faded(memory: CarMemory) -> FloatArray:
    """Return the covariance before the next passage: a little larger, but no larger than at first. (COUNT, COUNT)"""
    first = np.square(memory.first_std)
    covariance = np.array(memory.covariance)
    # A wandering constant would forget for ever; one drawn back to its origin forgets as far as was declared.
    keep = np.sqrt(np.maximum(0.0, 1.0 - np.square([constant.drift_std for constant in CONSTANTS]) / first))
    faded: FloatArray = covariance * np.outer(keep, keep) + np.diag(first * (1.0 - keep**2))
    return faded


def _parallel(one_std: float, other_std: float) -> float:
    """Return the standard deviation of two independent measurements together."""
    return one_std * other_std / math.hypot(one_std, other_std)


def _memory(
    mean: FloatArray, covariance: FloatArray, first_std: tuple[float, ...], *, passages_count: int
) -> CarMemory:
    symmetric = 0.5 * (covariance + covariance.T)
    return CarMemory(
        mean=tuple(mean.tolist()),
        covariance=tuple(map(tuple, symmetric.tolist())),
        first_std=tuple(map(float, first_std)),
        passages_count=passages_count,
    )
