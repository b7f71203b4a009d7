"""Cars that are not the one of the paper: a fleet of passenger cars from small to van, with passengers and luggage.

A drawn car is consistent in itself: the load moves its centre of gravity and adds to its inertia, springs and bars fit
its weight, tyres fit its axle loads. What a maker would never sell is drawn again: a car that oversteers at small
lateral acceleration, or that tips over before its tyres slide.

The ranges are declared estimates after public knowledge of cars on European roads; nothing was fitted.

References:
    Heydinger et al., Measured vehicle inertial parameters - NHTSA's data through November 1998 (SAE 1999-01-1336): yaw
    radius of gyration near the geometric mean of the axle distances, roll radius of gyration near two fifths of the
    track, height of the centre of gravity 0.5 to 0.6 m for cars and 0.6 to 0.8 m for utility vehicles and vans, static
    stability factors of 1.0 to 1.5. ICCT, European vehicle market statistics (pocketbook): mean mass in running order
    about 1,450 kg, mean wheelbase about 2.65 m, most cars driven by the front wheels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from roadgrip.units import GRAVITY_MPS2, deg_to_rad
from vehicle_client.estimation.handling import Handling, TyreCurve
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.simulator.driver import understeer_gradient_s2pm
from vehicle_client.simulator.vehicle import XC90, Tyre, Vehicle

DRIVER_KG = 75.0
PAYLOAD_RANGE_KG = (75.0, 450.0)
"""Driver alone to five people with luggage."""
STATIC_STABILITY_MIN_RATIO = 1.08
"""Half track over height of the centre of gravity: what loaded utility vehicles have, and more than tyres ever give."""
AIR_DENSITY_KGPM3 = 1.25
_TRIES_COUNT = 200


class VehicleClass(NamedTuple):
    """Ranges of one class of cars, empty but for fuel; each pair is drawn from uniformly.

    Attributes:
        name: What people call it.
        share_frac: Of the fleet.
        mass_kg: Without driver.
        wheelbase_m: Front to rear axle.
        track_m: Mean of both axles.
        cog_height_m: Of the centre of gravity.
        front_load_frac: Share of the weight on the front axle.
        rolling_radius_m: Of the tyres.
        drag_area_m2: Drag coefficient times frontal area.
        roll_deg: Lean in a turn of 1 g.
        front_driven_frac: Share of the class driven by the front wheels.
        all_driven_frac: Share driven by all wheels; the rest by the rear ones.
    """

    name: str
    share_frac: float
    mass_kg: tuple[float, float]
    wheelbase_m: tuple[float, float]
    track_m: tuple[float, float]
    cog_height_m: tuple[float, float]
    front_load_frac: tuple[float, float]
    rolling_radius_m: tuple[float, float]
    drag_area_m2: tuple[float, float]
    roll_deg: tuple[float, float]
    front_driven_frac: float
    all_driven_frac: float


CLASSES: tuple[VehicleClass, ...] = (
    VehicleClass(
        name="small",
        share_frac=0.20,
        mass_kg=(930.0, 1200.0),
        wheelbase_m=(2.35, 2.56),
        track_m=(1.42, 1.51),
        cog_height_m=(0.52, 0.56),
        front_load_frac=(0.59, 0.64),
        rolling_radius_m=(0.28, 0.31),
        drag_area_m2=(0.60, 0.70),
        roll_deg=(4.5, 6.5),
        front_driven_frac=1.0,
        all_driven_frac=0.0,
    ),
    VehicleClass(
        name="compact",
        share_frac=0.30,
        mass_kg=(1200.0, 1550.0),
        wheelbase_m=(2.55, 2.72),
        track_m=(1.51, 1.58),
        cog_height_m=(0.52, 0.57),
        front_load_frac=(0.57, 0.62),
        rolling_radius_m=(0.30, 0.325),
        drag_area_m2=(0.60, 0.72),
        roll_deg=(4.0, 6.0),
        front_driven_frac=0.92,
        all_driven_frac=0.06,
    ),
    VehicleClass(
        name="large",
        share_frac=0.15,
        mass_kg=(1480.0, 1950.0),
        wheelbase_m=(2.72, 2.98),
        track_m=(1.55, 1.63),
        cog_height_m=(0.53, 0.58),
        front_load_frac=(0.50, 0.58),
        rolling_radius_m=(0.31, 0.34),
        drag_area_m2=(0.56, 0.68),
        roll_deg=(3.5, 5.0),
        front_driven_frac=0.45,
        all_driven_frac=0.30,
    ),
    VehicleClass(
        name="utility",
        share_frac=0.30,
        mass_kg=(1350.0, 2200.0),
        wheelbase_m=(2.58, 3.00),
        track_m=(1.54, 1.68),
        cog_height_m=(0.60, 0.70),
        front_load_frac=(0.51, 0.60),
        rolling_radius_m=(0.32, 0.37),
        drag_area_m2=(0.74, 0.95),
        roll_deg=(4.0, 6.0),
        front_driven_frac=0.50,
        all_driven_frac=0.45,
    ),
    VehicleClass(
        name="van",
        share_frac=0.05,
        mass_kg=(1500.0, 2100.0),
        wheelbase_m=(2.75, 3.20),
        track_m=(1.55, 1.68),
        cog_height_m=(0.64, 0.72),
        front_load_frac=(0.54, 0.61),
        rolling_radius_m=(0.32, 0.35),
        drag_area_m2=(0.85, 1.05),
        roll_deg=(4.5, 6.5),
        front_driven_frac=0.85,
        all_driven_frac=0.10,
    ),
)


def draw_vehicle(rng: np.random.Generator) -> Vehicle:
    """Return a car of the fleet as it is on the road that day: class, build, load and tyres drawn at random.

    Args:
        rng: Source of chance; every call takes the same number of draws.

    Raises:
        RuntimeError: No sound car was drawn in many tries, which the ranges do not let happen.
    """
    own = np.random.default_rng(rng.integers(2**63, size=2))
    for _ in range(_TRIES_COUNT):
        vehicle = _drawn(own)
        if is_sound(vehicle):
            return vehicle
    message = "no sound car within the ranges of the fleet"
    raise RuntimeError(message)


def is_sound(vehicle: Vehicle) -> bool:
    """Return whether a maker would sell the car: understeering at small lateral acceleration, and sliding, not tipping.

    Args:
        vehicle: The car as loaded.
    """
    stability_ratio = 0.25 * (vehicle.front_track_m + vehicle.rear_track_m) / vehicle.cog_height_m
    return understeer_gradient_s2pm(vehicle) > 0.0 and stability_ratio >= STATIC_STABILITY_MIN_RATIO


def geometry_of(vehicle: Vehicle) -> VehicleGeometry:
    """Return what the car's own client knows of it: dimensions, and where the centre of gravity lies as loaded.

    The load is taken as known, as from levelling sensors; masses, springs and tyres are not known to it.
    """
    return VehicleGeometry(
        wheelbase_m=vehicle.wheelbase_m,
        track_m=0.5 * (vehicle.front_track_m + vehicle.rear_track_m),
        front_axle_m=vehicle.front_axle_m,
    )


def handling_of(vehicle: Vehicle) -> Handling:
    """Return what a maker who knows the car exactly declares to its client: the best case of declared constants."""
    tyre = vehicle.tyre
    mass, wheelbase = vehicle.mass_kg, vehicle.wheelbase_m
    front_frac = vehicle.rear_axle_m / wheelbase
    arm_m = vehicle.cog_height_m - (
        vehicle.front_roll_centre_m * front_frac + vehicle.rear_roll_centre_m * (1.0 - front_frac)
    )
    lean_s2pm = mass * arm_m / (vehicle.roll_stiffness_nmprad - mass * GRAVITY_MPS2 * arm_m)
    rolled_m = vehicle.roll_stiffness_nmprad * lean_s2pm / mass
    share = vehicle.front_roll_stiffness_frac
    return Handling(
        mass_kg=mass,
        yaw_inertia_kgm2=vehicle.yaw_inertia_kgm2,
        cog_height_m=vehicle.cog_height_m,
        front_transfer_height_m=share * rolled_m + front_frac * vehicle.front_roll_centre_m,
        rear_transfer_height_m=(1.0 - share) * rolled_m + (1.0 - front_frac) * vehicle.rear_roll_centre_m,
        roll_gradient_s2pm=lean_s2pm,
        pitch_gradient_s2pm=vehicle.pitch_per_accel_s2pm_ratio,
        drag_kgpm=vehicle.drag_npm2ps2_ratio,
        front_drive_frac=vehicle.front_drive_frac,
        front_brake_frac=vehicle.front_brake_frac,
        engine_brake_mps2=vehicle.engine_brake_mps2,
        steer_compliance_radpn=vehicle.steer_compliance_radpn,
        tyre=TyreCurve(
            nominal_load_n=tyre.nominal_load_n,
            stiffness_ratio=tyre.slope_y1_ratio,
            stiffness_twice_ratio=tyre.slope_y2_ratio,
            peak_twice_ratio=tyre.peak_y2_ratio / tyre.peak_y1_ratio,
            peak_slip_ratio=tyre.peak_slip_y1_ratio / tyre.peak_y1_ratio,
            peak_slip_twice_ratio=tyre.peak_slip_y2_ratio / tyre.peak_y1_ratio,
            along_stiffness_ratio=tyre.slope_x1_ratio,
            relaxation_m=0.5 * tyre.slope_y1_ratio * tyre.nominal_load_n / tyre.stiffness_y_npm,
            rolling_resistance_ratio=tyre.rolling_resistance_ratio,
        ),
    )


def _drawn(rng: np.random.Generator) -> Vehicle:
    shares = [c.share_frac for c in CLASSES]
    of = CLASSES[int(rng.choice(len(CLASSES), p=shares))]
    empty_kg = rng.uniform(*of.mass_kg)
    # Within a class long cars are wide, heavy and on large wheels: one draw for size, a little of its own for each.
    size = (empty_kg - of.mass_kg[0]) / (of.mass_kg[1] - of.mass_kg[0])
    wheelbase_m = _sized(rng, of.wheelbase_m, size)
    track_m = _sized(rng, of.track_m, size)
    rolling_radius_m = _sized(rng, of.rolling_radius_m, size)
    body = _loaded(
        rng,
        empty_kg=empty_kg,
        wheelbase_m=wheelbase_m,
        track_m=track_m,
        front_axle_m=wheelbase_m * (1.0 - rng.uniform(*of.front_load_frac)),
        height_m=rng.uniform(*of.cog_height_m),
    )
    front_centre_m, rear_centre_m = rng.uniform(0.03, 0.10), rng.uniform(0.10, 0.16)
    arm_m = body.height_m - (front_centre_m * (wheelbase_m - body.front_axle_m) + rear_centre_m * body.front_axle_m) / (
        wheelbase_m
    )
    # A turn of 1 g leans the empty car by so much; springs and bars are made for half the load.
    lean_rad = deg_to_rad(rng.uniform(*of.roll_deg))
    design_kg = empty_kg + 0.5 * sum(PAYLOAD_RANGE_KG)
    stiffness_nmprad = design_kg * GRAVITY_MPS2 * arm_m * (1.0 + 1.0 / lean_rad)
    restoring_nmprad = stiffness_nmprad - body.mass_kg * GRAVITY_MPS2 * arm_m
    swinging_kgm2 = body.roll_inertia_kgm2 + body.mass_kg * arm_m**2
    unsprung_kg = 0.25 * empty_kg * rng.uniform(0.085, 0.105)
    sprung_kg = 0.25 * design_kg - unsprung_kg
    wheel_rate_npm = sprung_kg * (2.0 * math.pi * rng.uniform(1.15, 1.45)) ** 2
    tyre = _tyre(rng, design_load_n=0.25 * design_kg * GRAVITY_MPS2, rolling_radius_m=rolling_radius_m)
    drive = rng.random()
    if drive < of.front_driven_frac:
        front_drive_frac = 1.0
    elif drive < of.front_driven_frac + of.all_driven_frac:
        front_drive_frac = rng.uniform(0.4, 0.7)
    else:
        front_drive_frac = 0.0
    track_change_m = rng.uniform(-0.02, 0.02)
    return XC90._replace(
        mass_kg=body.mass_kg,
        yaw_inertia_kgm2=body.yaw_inertia_kgm2,
        roll_inertia_kgm2=body.roll_inertia_kgm2,
        front_axle_m=body.front_axle_m,
        rear_axle_m=wheelbase_m - body.front_axle_m,
        front_track_m=track_m + 0.5 * track_change_m,
        rear_track_m=track_m - 0.5 * track_change_m,
        cog_height_m=body.height_m,
        front_roll_centre_m=front_centre_m,
        rear_roll_centre_m=rear_centre_m,
        roll_stiffness_nmprad=stiffness_nmprad,
        roll_damping_nmsprad=rng.uniform(0.25, 0.40) * 2.0 * math.sqrt(restoring_nmprad * swinging_kgm2),
        front_roll_stiffness_frac=rng.uniform(0.52, 0.62),
        pitch_per_accel_s2pm_ratio=rng.uniform(0.002, 0.004),
        load_transfer_lag_s=rng.uniform(0.06, 0.10),
        # Discs of a kind: their inertia goes with mass times radius squared.
        wheel_inertia_kgm2=XC90.wheel_inertia_kgm2
        * (unsprung_kg / XC90.unsprung_mass_kg)
        * (rolling_radius_m / XC90.tyre.rolling_radius_m) ** 2
        * rng.uniform(0.9, 1.1),
        unsprung_mass_kg=unsprung_kg,
        wheel_rate_npm=wheel_rate_npm,
        damper_nspm=rng.uniform(0.25, 0.40) * 2.0 * math.sqrt(wheel_rate_npm * sprung_kg),
        drag_npm2ps2_ratio=0.5 * AIR_DENSITY_KGPM3 * rng.uniform(*of.drag_area_m2),
        power_w=empty_kg * rng.uniform(45.0, 95.0),
        front_drive_frac=front_drive_frac,
        # What the front axle bears while braking at 0.45 to 0.75 g: more would leave the rear axle idle, less lock it.
        front_brake_frac=(wheelbase_m - body.front_axle_m + rng.uniform(0.45, 0.75) * body.height_m) / wheelbase_m,
        engine_brake_mps2=rng.uniform(0.3, 0.7),
        brake_limit_mps2=rng.uniform(10.0, 12.0),
        brake_lag_s=rng.uniform(0.06, 0.10),
        steer_limit_rad=rng.uniform(0.58, 0.66),
        # Hands turn the wheel by 600 degrees a second; the gear divides by 14 to 17.
        steer_rate_limit_radps=deg_to_rad(600.0) / rng.uniform(14.0, 17.0),
        tyre=tyre,
    )


class _Body(NamedTuple):
    """The loaded body: masses add up, and so do inertias about the common centre of gravity."""

    mass_kg: float
    front_axle_m: float
    height_m: float
    yaw_inertia_kgm2: float
    roll_inertia_kgm2: float


def _loaded(
    rng: np.random.Generator,
    *,
    empty_kg: float,
    wheelbase_m: float,
    track_m: float,
    front_axle_m: float,
    height_m: float,
) -> _Body:
    payload_kg = rng.uniform(*PAYLOAD_RANGE_KG)
    # The driver sits a little before the middle of the wheelbase; who and what comes after him lies farther back.
    others_kg = payload_kg - DRIVER_KG
    masses = np.array([empty_kg, DRIVER_KG, others_kg])
    behind_m = np.array([front_axle_m, 0.47 * wheelbase_m, rng.uniform(0.55, 0.90) * wheelbase_m])
    above_m = np.array([height_m, height_m + rng.uniform(0.05, 0.15), height_m + rng.uniform(0.0, 0.15)])
    mass_kg = float(masses.sum())
    cog_m, cog_height_m = float(masses @ behind_m) / mass_kg, float(masses @ above_m) / mass_kg
    empty_yaw = empty_kg * front_axle_m * (wheelbase_m - front_axle_m) * rng.uniform(0.90, 1.06)
    empty_roll = empty_kg * (rng.uniform(0.37, 0.42) * track_m) ** 2
    return _Body(
        mass_kg=mass_kg,
        front_axle_m=cog_m,
        height_m=cog_height_m,
        # Who and what comes after the driver is spread over seats and boot, half a metre to either side of its middle.
        yaw_inertia_kgm2=empty_yaw + float(masses @ (behind_m - cog_m) ** 2) + others_kg * 0.5**2,
        # People and luggage lie a quarter of the track beside the middle.
        roll_inertia_kgm2=empty_roll + float(masses @ (above_m - cog_height_m) ** 2) + payload_kg * (track_m / 4) ** 2,
    )


def _tyre(rng: np.random.Generator, *, design_load_n: float, rolling_radius_m: float) -> Tyre:
    """Return tyres chosen for a load: of softer or stiffer make, more or less sensitive to load, grip as the road's.

    Winter tyres are about a sixth softer than the reference, sporty ones as much stiffer. A stiffer tyre reaches its
    peak at a smaller slip.
    """
    ref = XC90.tyre
    nominal_load_n = design_load_n * rng.uniform(0.95, 1.15)
    stiffer_x, stiffer_y = rng.uniform(0.85, 1.15), rng.uniform(0.85, 1.18)
    slip_x = rng.uniform(0.92, 1.08) / math.sqrt(stiffer_x)
    slip_y = rng.uniform(0.92, 1.08) / math.sqrt(stiffer_y)
    sensitivity_ratio = rng.uniform(0.7, 1.2)
    sliding_ratio = rng.uniform(0.96, 1.04)

    def at_twice(at_once_ratio: float, at_twice_ratio: float) -> float:
        return at_once_ratio * (1.0 - sensitivity_ratio * (1.0 - at_twice_ratio / at_once_ratio))

    carcass_ratio = nominal_load_n / ref.nominal_load_n * rng.uniform(0.85, 1.15)
    return ref._replace(
        nominal_load_n=nominal_load_n,
        slope_x1_ratio=stiffer_x * ref.slope_x1_ratio,
        slope_x2_ratio=stiffer_x * at_twice(ref.slope_x1_ratio, ref.slope_x2_ratio),
        peak_x2_ratio=at_twice(ref.peak_x1_ratio, ref.peak_x2_ratio),
        peak_slip_x1_ratio=slip_x * ref.peak_slip_x1_ratio,
        peak_slip_x2_ratio=slip_x * ref.peak_slip_x2_ratio,
        slide_x1_ratio=sliding_ratio * ref.slide_x1_ratio,
        slide_x2_ratio=sliding_ratio * at_twice(ref.slide_x1_ratio, ref.slide_x2_ratio),
        slope_y1_ratio=stiffer_y * ref.slope_y1_ratio,
        slope_y2_ratio=stiffer_y * at_twice(ref.slope_y1_ratio, ref.slope_y2_ratio),
        peak_y2_ratio=at_twice(ref.peak_y1_ratio, ref.peak_y2_ratio),
        peak_slip_y1_ratio=slip_y * ref.peak_slip_y1_ratio,
        peak_slip_y2_ratio=slip_y * ref.peak_slip_y2_ratio,
        slide_y1_ratio=sliding_ratio * ref.slide_y1_ratio,
        slide_y2_ratio=sliding_ratio * at_twice(ref.slide_y1_ratio, ref.slide_y2_ratio),
        stiffness_x_npm=carcass_ratio * stiffer_x * ref.stiffness_x_npm,
        stiffness_y_npm=carcass_ratio * stiffer_y * ref.stiffness_y_npm,
        damping_x_nspm=carcass_ratio * ref.damping_x_nspm,
        damping_y_nspm=carcass_ratio * ref.damping_y_nspm,
        rolling_radius_m=rolling_radius_m,
        rolling_resistance_ratio=rng.uniform(0.008, 0.012),
        vertical_stiffness_npm=ref.vertical_stiffness_npm * nominal_load_n / ref.nominal_load_n * rng.uniform(0.9, 1.1),
    )


def _sized(rng: np.random.Generator, limits: tuple[float, float], size: float) -> float:
    low, high = limits
    return low + (high - low) * float(np.clip(0.7 * size + 0.3 * rng.random(), 0.0, 1.0))
