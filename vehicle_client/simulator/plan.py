"""What a drive is asked to be: the friction, the driver, the sensors, the seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, IDEAL_NOISE
from vehicle_client.simulator.vehicle import XC90, Vehicle

if TYPE_CHECKING:
    import numpy as np

    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

GUESS_SIGMA_RATIO = 0.35
"""Spread of a prudent driver's visual guess of the surface: standard deviation of its logarithm, one draw per run."""
WEAR_RANGE = (0.8, 1.0)
"""Factor of tyre wear and pressure on friction (the paper, section "Intervals of friction conditions")."""
REFERENCE_PRESSURE_PA = 250_000.0
"""Tyre pressure at which friction is what wear leaves of the road's."""
_FRICTION_PER_DROP_RATIO = 0.08
_DROP_PA = 50_000.0
"""A drop from 2.5 to 2.0 bar raises friction by about eight per cent (the paper, after Braghin et al., 2006)."""
SPEED_SPREAD_RATIO = 0.2
"""Half width of the triangular distribution of speeds around the rated one (the paper)."""


class SensorGrade(StrEnum):
    """Which sensors the vehicle carries."""

    IDEAL = "ideal"
    """Exact sensors on a real road surface: the paper's setting."""
    AUTOMOTIVE = "automotive"
    """What a production car carries."""


DECLARED_NOISE = {SensorGrade.AUTOMOTIVE: AUTOMOTIVE_NOISE, SensorGrade.IDEAL: IDEAL_NOISE}
"""What a maker tells the car's client of sensors of either grade."""


class DriverKind(StrEnum):
    """What a driver goes by when he chooses his speed."""

    PRUDENT = "prudent"
    """Has a visual guess of the surface, right within a third, and feels when it was too high."""
    REACTING = "reacting"
    """Judges the surface by what he feels alone."""


class RoughnessClass(StrEnum):
    """How uneven the road is: the classes of ISO 8608, from very good asphalt (A) on."""

    A = "a"
    B = "b"
    C = "c"
    D = "d"
    E = "e"


class StabilitySystems(NamedTuple):
    """Which of the car's stability systems work.

    Attributes:
        abs_on: Anti-lock braking.
        tcs_on: Traction control: less drive torque while driven wheels spin.
        esc_on: Yaw control: brakes single wheels and cuts torque against over- and understeer.
    """

    abs_on: bool = True
    tcs_on: bool = True
    esc_on: bool = True


ALL_SYSTEMS = StabilitySystems()
NO_SYSTEMS = StabilitySystems(abs_on=False, tcs_on=False, esc_on=False)


class AmplitudeScales(NamedTuple):
    """How many times as large disturbances are as their sources say: for tables of sensitivity, and nothing else.

    Attributes:
        sensors_ratio: Of every error of sensors and map.
        roughness_ratio: Of the heights of the road's surface.
    """

    sensors_ratio: float = 1.0
    roughness_ratio: float = 1.0


UNSCALED = AmplitudeScales()


class Braking(NamedTuple):
    """An order to brake on a given stretch, for tests of brakes and of the observer's straight case.

    Attributes:
        station_m: Where the pedal goes down.
        decel_mps2: What the pedal asks for; more than the road gives is a full braking on the limit.
        end_speed_mps: Speed at which the order is fulfilled; the drive goes on with it.
    """

    station_m: float
    decel_mps2: float
    end_speed_mps: float


class Driver(NamedTuple):
    """One skilled driver.

    He never knows the friction. He has a guess, and lowers it while he feels the tyres slide.

    Attributes:
        friction_guess_mu: What the surface looks like to him; infinite for one who does not judge by looks.
        grip_share_ratio: Share of the guessed grip that he is willing to use in a curve.
        comfort_accel_mps2: Lateral acceleration that he does not exceed by choice, whatever the grip.
        braking_mps2: Deceleration that he plans with when he sees a curve, on a surface that allows it.
        sight_m: How far ahead he knows the road, by sight, signs or habit.
        preview_s: Time ahead at which he aims the car.
        steer_lag_s: First-order lag of arms and steering gear.
        yaw_damping_s_ratio: Counter-steer per yaw rate error, rad per rad/s.
        slide_feeling_ratio: Front or rear slip over that of the peak at which he feels that the tyres slide.
    """

    friction_guess_mu: float = math.inf
    grip_share_ratio: float = 0.75
    comfort_accel_mps2: float = 6.0
    braking_mps2: float = 2.0
    sight_m: float = 200.0
    preview_s: float = 0.9
    steer_lag_s: float = 0.12
    yaw_damping_s_ratio: float = 0.08
    slide_feeling_ratio: float = 0.6


UNIMPRESSED = Driver()
"""The middle of the ranges, judging the surface by what he feels alone."""


@dataclass(frozen=True, slots=True)
class FrictionProfile:
    """Friction along the section for a new tyre, one value per wheel track; straight lines between, constant outside.

    Attributes:
        station_m: Along the section, increasing. (n,)
        left_mu: Under the left wheels. (n,)
        right_mu: Under the right wheels. (n,)
    """

    station_m: FloatArray
    left_mu: FloatArray
    right_mu: FloatArray


@dataclass(frozen=True, slots=True)
class PassagePlan:
    """Everything but the road that a drive depends on; with the section it gives the same drive to the last bit.

    Attributes:
        base_friction_mu: What the road offers a new tyre, on approach and exit too.
        seed: Of everything random in the drive: surface profile, sensor errors, noise.
        wear_factor: Tyre wear, multiplies friction; 0.8 to 1. The paper's designs put tyre pressure into it, too.
        pressure_pa: Of the tyres, where it is studied apart from wear.
        target_speed_mps: Speed the driver likes where nothing holds him back; the rated speed if None.
        driver: The driver.
        friction_profile: Friction that varies along the section; replaces the base friction.
        sensor_grade: Which sensors the trace comes from.
        with_gnss: Whether the trace holds position fixes; needs a section with anchors.
        approach_m: Length driven before the section starts; straight, but for an easing into a curve cut by the map.
        exit_m: Length driven beyond its end.
        braking: A full stop or a slowing down on order.
        stability: Which of ABS, traction control and ESC work.
        roughness: How uneven the road is; a plane if None.
        vehicle: The car.
        scales: How many times as large disturbances are as usual.
        sensor_seed: Of what one car's sensors get wrong on all its drives alike: scales, mounting, radii, offsets of
            steering and accelerometers. The offsets of its gyros stay the drive's own, since they are zeroed at every
            standstill. If None, all errors are drawn for the drive.
    """

    base_friction_mu: float
    seed: int
    wear_factor: float = 1.0
    target_speed_mps: float | None = None
    driver: Driver = UNIMPRESSED
    friction_profile: FrictionProfile | None = None
    sensor_grade: SensorGrade = SensorGrade.AUTOMOTIVE
    with_gnss: bool = False
    approach_m: float = 70.0
    exit_m: float = 70.0
    braking: Braking | None = None
    stability: StabilitySystems = ALL_SYSTEMS
    roughness: RoughnessClass | None = RoughnessClass.A
    pressure_pa: float = REFERENCE_PRESSURE_PA
    vehicle: Vehicle = XC90
    scales: AmplitudeScales = UNSCALED
    sensor_seed: int | None = None

    @property
    def tyre_factor(self) -> float:
        """What wear and pressure leave of the road's friction."""
        return self.wear_factor * (
            1.0 + _FRICTION_PER_DROP_RATIO * (REFERENCE_PRESSURE_PA - self.pressure_pa) / _DROP_PA
        )


def draw_driver(rng: np.random.Generator, *, base_friction_mu: float, kind: DriverKind = DriverKind.PRUDENT) -> Driver:
    """Return a driver drawn from the documented ranges.

    The prudent one sees the surface through a lognormal error of 35 %, one draw per run. He knows nothing of his
    tyres' wear, and the true friction enters nowhere else.

    Args:
        rng: Source of chance; the same number of draws for either kind.
        base_friction_mu: What the surface offers a new tyre.
        kind: What he goes by.
    """
    guess_mu = base_friction_mu * math.exp(GUESS_SIGMA_RATIO * rng.standard_normal())
    return Driver(
        friction_guess_mu=guess_mu if kind is DriverKind.PRUDENT else math.inf,
        grip_share_ratio=rng.uniform(0.6, 0.9),
        comfort_accel_mps2=rng.uniform(4.5, 7.0),
        braking_mps2=rng.uniform(1.5, 2.5),
        sight_m=rng.uniform(150.0, 250.0),
        preview_s=rng.uniform(0.7, 1.1),
        steer_lag_s=rng.uniform(0.08, 0.16),
        yaw_damping_s_ratio=rng.uniform(0.04, 0.12),
        slide_feeling_ratio=rng.uniform(0.45, 0.8),
    )


def draw_plan(
    rng: np.random.Generator,
    *,
    section: RoadSection,
    base_friction_mu: float,
    grade: SensorGrade = SensorGrade.AUTOMOTIVE,
    kind: DriverKind = DriverKind.PRUDENT,
    friction_profile: FrictionProfile | None = None,
    with_gnss: bool = False,
    vehicle: Vehicle = XC90,
) -> PassagePlan:
    """Return the plan of one vehicle as the paper's test matrix draws it.

    Wear is uniform in [0.8, 1]; the speed triangular around the rated one, 20 % to either side.

    Args:
        rng: Source of chance; every call takes the same number of draws.
        section: The road, for its rated speed.
        base_friction_mu: What the surface offers a new tyre.
        grade: Which sensors the vehicle carries.
        kind: What the driver goes by.
        friction_profile: Friction that varies along the section.
        with_gnss: Whether the trace shall hold position fixes.
        vehicle: The car.
    """
    low, high = WEAR_RANGE
    wear_factor = rng.uniform(low, high)
    rated_mps = section.speed_limit_mps
    target_mps = rng.triangular(
        (1.0 - SPEED_SPREAD_RATIO) * rated_mps, rated_mps, (1.0 + SPEED_SPREAD_RATIO) * rated_mps
    )
    driver = draw_driver(rng, base_friction_mu=base_friction_mu, kind=kind)
    return PassagePlan(
        base_friction_mu=base_friction_mu,
        seed=int(rng.integers(2**63)),
        wear_factor=wear_factor,
        target_speed_mps=target_mps,
        driver=driver,
        friction_profile=friction_profile,
        sensor_grade=grade,
        with_gnss=with_gnss,
        vehicle=vehicle,
    )
