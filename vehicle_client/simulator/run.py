"""The door of the simulator: a section and a plan in, a drive out.

A drive depends on its section and its plan alone: one at a time or in batches, on any number of threads or processes,
it comes out the same to the last bit. The compiled part releases the interpreter's lock, so that callers may spread
plans over threads as well as over processes; this module starts neither.

The first call on a machine compiles for some tens of seconds (`warm_up` does nothing else); later processes read the
compiler's cache.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.geodesy import frame_of
from roadgrip.section import build_section
from roadgrip.units import SAMPLE_S, FloatArray
from vehicle_client.simulator import chassis, journey
from vehicle_client.simulator.drive import Drive, DriveOutcome, Truth
from vehicle_client.simulator.plan import (
    ALL_SYSTEMS,
    NO_SYSTEMS,
    Braking,
    Driver,
    DriverKind,
    FrictionProfile,
    PassagePlan,
    RoughnessClass,
    SensorGrade,
    StabilitySystems,
    draw_driver,
    draw_plan,
)
from vehicle_client.simulator.sensors import SENSORS, Motion, gnss_track, trace_of
from vehicle_client.simulator.surface import class_density_m3, roughness_m
from vehicle_client.simulator.track import Track, track_of
from vehicle_client.simulator.vehicle import Vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roadgrip.section import RoadSection
    from roadgrip.units import BoolArray

__all__ = [
    "ALL_SYSTEMS",
    "NO_SYSTEMS",
    "Braking",
    "Drive",
    "DriveOutcome",
    "Driver",
    "DriverKind",
    "FrictionProfile",
    "PassagePlan",
    "RoughnessClass",
    "SensorGrade",
    "StabilitySystems",
    "Truth",
    "compiled_cache_key",
    "draw_driver",
    "draw_plan",
    "simulate_passage",
    "simulate_passages",
    "warm_up",
]

LABEL_WINDOW_M = 10.0
PEAK_WINDOW_S = 0.1
_OUTCOMES = {
    journey.COMPLETED: DriveOutcome.COMPLETED,
    journey.LEFT_ROAD: DriveOutcome.LEFT_ROAD,
    journey.SPUN: DriveOutcome.SPUN,
    journey.STOPPED: DriveOutcome.STOPPED,
    journey.TIMED_OUT: DriveOutcome.TIMED_OUT,
}


def simulate_passage(section: RoadSection, plan: PassagePlan, *, step_s: float = journey.STEP_S) -> Drive:
    """Return one drive over a section, approach and exit included.

    A drive that leaves the road or spins is a value too: see `Drive.outcome`.

    Args:
        section: The road.
        plan: Everything else.
        step_s: Time step of the car; a whole fraction of 10 ms. The default is what results are made with.

    Raises:
        SectionError: Position fixes are asked for, but the section has no anchors.
        ValueError: The plan is out of range.
    """
    _check(section, plan)
    surface_rng, sensor_rng, gnss_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(plan.seed).spawn(3))
    track = track_of(section, plan)
    rough = np.empty((0, 2))
    if plan.roughness is not None:
        rough = roughness_m(
            surface_rng, length_m=track.step_m * len(track.x_m), density_m3=class_density_m3(plan.roughness)
        )
    target_mps = section.speed_limit_mps if plan.target_speed_mps is None else plan.target_speed_mps
    errand = journey.Errand(
        start_m=track.start_m,
        step_m=track.step_m,
        approach_m=float(plan.approach_m),
        finish_m=section.length_m + plan.exit_m,
        target_mps=float(target_mps),
        brake_from_m=np.inf if plan.braking is None else float(plan.braking.station_m),
        brake_mps2=0.0 if plan.braking is None else float(plan.braking.decel_mps2),
        brake_until_mps=-1.0 if plan.braking is None else float(plan.braking.end_speed_mps),
        abs_on=float(plan.stability.abs_on),
        tcs_on=float(plan.stability.tcs_on),
        esc_on=float(plan.stability.esc_on),
        step_s=step_s,
    )
    longest_s = (plan.approach_m + errand.finish_m) / journey.SLOWEST_MEAN_MPS + 10.0
    log = np.empty((int(longest_s / SAMPLE_S), journey.LOG_SIZE))
    driver = Driver._make(float(v) for v in plan.driver)
    count, ending = journey.drive(track.lines, rough, errand, driver, plan.vehicle, log)
    log = log[:count]

    truth = _truth(log, track)
    sensors = SENSORS[plan.sensor_grade]
    gnss = None
    if plan.with_gnss:
        gnss = gnss_track(truth.x_m, truth.y_m, frame=frame_of(section), rng=gnss_rng, sensors=sensors)
    trace = trace_of(_motion(log, plan.vehicle), rng=sensor_rng, sensors=sensors, gnss=gnss)
    inside = (truth.station_m >= 0.0) & (truth.station_m <= section.length_m)
    return Drive(
        plan=plan,
        outcome=_OUTCOMES[ending],
        trace=trace,
        truth=truth,
        label_mu=_lowest_moving_mean_mu(truth, inside),
        lowest_mu=float(truth.friction_mu[inside].min()) if inside.any() else float(truth.friction_mu.min()),
        abs_active_frac=_share(truth.abs_active, inside),
        tcs_active_frac=_share(truth.tcs_active, inside),
        esc_active_frac=_share(truth.esc_active, inside),
        peak_utilisation_ratio=_peak_ratio(truth.utilisation_ratio, inside),
        peak_sideslip_rad=float(np.abs(truth.sideslip_rad[inside]).max()) if inside.any() else 0.0,
    )


def simulate_passages(section: RoadSection, plans: Sequence[PassagePlan]) -> list[Drive]:
    """Return the drives of many plans, in their order; each is what `simulate_passage` returns for it."""
    return [simulate_passage(section, plan) for plan in plans]


def warm_up() -> None:
    """Compile, or read the compiler's cache, so that the next drive runs at full speed."""
    nodes = [[10.0 * i, 0.0, 0.0] for i in range(5)]
    section = build_section(section_id="warm-up", name="warm-up", nodes_m=nodes, speed_limit_mps=20.0)
    simulate_passage(section, PassagePlan(base_friction_mu=0.5, seed=0, approach_m=0.0, exit_m=0.0))


def compiled_cache_key() -> str:
    """Return the digest of all compiled code of the simulator, 14 hexadecimal characters.

    The compiler's cache already goes by it; it also names the simulator in the provenance of a data set.
    """
    return f"{journey.DIGEST:014x}"


def _check(section: RoadSection, plan: PassagePlan) -> None:
    if not 0.02 <= plan.base_friction_mu <= 2.0 or not 0.1 <= plan.wear_factor <= 2.0:
        message = f"friction {plan.base_friction_mu} times wear {plan.wear_factor} is no road's"
        raise ValueError(message)
    if not 1.5 <= plan.pressure_bar <= 3.5:
        message = f"a tyre pressure of {plan.pressure_bar} bar is not between 1.5 and 3.5"
        raise ValueError(message)
    order = plan.braking
    if order is not None and not (order.decel_mps2 > 0.0 and 0.5 <= order.end_speed_mps <= 80.0):
        message = f"braking at {order.decel_mps2} m/s2 down to a speed of {order.end_speed_mps} m/s cannot be ordered"
        raise ValueError(message)
    if plan.target_speed_mps is not None and not 1.0 <= plan.target_speed_mps <= 80.0:
        message = f"a target speed of {plan.target_speed_mps} m/s is not between 1 and 80"
        raise ValueError(message)
    if not (0.0 <= plan.approach_m <= 1000.0 and 0.0 <= plan.exit_m <= 1000.0):
        message = "approach and exit are between 0 and 1000 m long"
        raise ValueError(message)
    known = plan.friction_profile
    if known is not None:
        shapes = {np.shape(values) for values in (known.station_m, known.left_mu, known.right_mu)}
        values = np.concatenate([np.ravel(known.left_mu), np.ravel(known.right_mu)]) * plan.tyre_factor
        increasing = len(shapes) == 1 and bool((np.diff(known.station_m) > 0.0).all())
        if not increasing or values.size == 0 or not bool(((values >= 0.02) & (values <= 2.0)).all()):
            message = "a friction profile needs increasing stations and as many frictions, each that of a road"
            raise ValueError(message)
    if plan.with_gnss and not section.anchors:
        message = f"section {section.section_id!r} has no anchors, so its position on earth is unknown"
        raise SectionError(message)


def _truth(log: FloatArray, track: Track) -> Truth:
    station, offset = log[:, chassis.STATION], log[:, chassis.OFFSET]
    grid = track.station_m
    heading = np.interp(station, grid, track.heading_rad)
    vx, vy = log[:, chassis.VELOCITY_X], log[:, chassis.VELOCITY_Y]
    load = log[:, journey.LOG_LOAD : journey.LOG_LOAD + 4]
    force_x = log[:, journey.LOG_FORCE_X : journey.LOG_FORCE_X + 4]
    force_y = log[:, journey.LOG_FORCE_Y : journey.LOG_FORCE_Y + 4]
    friction = log[:, journey.LOG_FRICTION : journey.LOG_FRICTION + 4]
    grip = friction * load
    front = np.hypot(force_x[:, :2].sum(1), force_y[:, :2].sum(1)) / np.maximum(1.0, grip[:, :2].sum(1))
    rear = np.hypot(force_x[:, 2:].sum(1), force_y[:, 2:].sum(1)) / np.maximum(1.0, grip[:, 2:].sum(1))
    return Truth(
        time_s=SAMPLE_S * np.arange(len(log), dtype=np.float64),
        station_m=station.copy(),
        lateral_offset_m=offset.copy(),
        x_m=np.interp(station, grid, track.x_m) - offset * np.sin(heading),
        y_m=np.interp(station, grid, track.y_m) + offset * np.cos(heading),
        heading_rad=heading + log[:, chassis.ANGLE],
        velocity_x_mps=vx.copy(),
        velocity_y_mps=vy.copy(),
        sideslip_rad=np.arctan2(vy, vx),
        yaw_rate_radps=log[:, chassis.YAW_RATE].copy(),
        roll_rad=log[:, chassis.ROLL] + log[:, journey.LOG_SHAKE_ROLL],
        bank_rad=log[:, journey.LOG_BANK].copy(),
        accel_x_mps2=log[:, chassis.ACCEL_X].copy(),
        accel_y_mps2=log[:, chassis.ACCEL_Y].copy(),
        steer_rad=log[:, chassis.STEER].copy(),
        wheel_load_n=load.copy(),
        wheel_force_x_n=force_x.copy(),
        wheel_force_y_n=force_y.copy(),
        friction_mu=_load_weighted(friction, load),
        utilisation_ratio=np.maximum(front, rear),
        abs_active=log[:, journey.LOG_ABS] > 0.0,
        tcs_active=log[:, journey.LOG_TCS] > 0.0,
        esc_active=log[:, journey.LOG_ESC] > 0.0,
    )


def _load_weighted(friction: FloatArray, load: FloatArray) -> FloatArray:
    """Return the mean under the wheels; exactly the friction where it is the same under all, whatever the loads."""
    first = friction[:, :1]
    weighted: FloatArray = first[:, 0] + ((friction - first) * load).sum(1) / np.maximum(1.0, load.sum(1))
    return weighted


def _motion(log: FloatArray, vehicle: Vehicle) -> Motion:
    """Return what sensors sense: the motion in the axes of the body, which leans against the road."""
    roll = log[:, chassis.ROLL] + log[:, journey.LOG_SHAKE_ROLL]
    pitch = -vehicle.pitch_per_accel_s2pm_ratio * log[:, chassis.LAGGED_X]
    force_x, force_y = log[:, chassis.FORCE_X], log[:, chassis.FORCE_Y]
    normal, yaw = log[:, journey.LOG_NORMAL], log[:, chassis.YAW_RATE]
    roll_rate = log[:, chassis.ROLL_RATE] + log[:, journey.LOG_SHAKE_RATE] + log[:, journey.LOG_ROLL_RATE_ROAD]
    # Uphill the nose points up, and yaw about the vertical has a part along x.
    roll_rate = roll_rate + yaw * np.sin(np.arctan(log[:, journey.LOG_GRADE]) - pitch)
    pitch_rate = np.gradient(pitch, SAMPLE_S) if len(log) > 1 else np.zeros(len(log))
    pitch_rate = pitch_rate + yaw * np.sin(log[:, journey.LOG_BANK] + roll)
    force = np.column_stack(
        [
            force_x * np.cos(pitch) - normal * np.sin(pitch),
            force_y * np.cos(roll) + normal * np.sin(roll),
            normal * np.cos(roll) * np.cos(pitch) - force_y * np.sin(roll) + force_x * np.sin(pitch),
        ]
    )
    stability: BoolArray = log[:, journey.LOG_ABS : journey.LOG_ESC + 1].max(axis=1) > 0.0
    return Motion(
        specific_force_mps2=force,
        rate_radps=np.column_stack([roll_rate, pitch_rate, yaw * np.cos(roll)]),
        steer_rad=log[:, chassis.STEER],
        wheel_speed_mps=log[:, journey.LOG_SPIN : journey.LOG_SPIN + 4] * vehicle.tyre.rolling_radius_m,
        stability_active=stability,
    )


def _lowest_moving_mean_mu(truth: Truth, inside: BoolArray) -> float:
    """Return the lowest mean of the experienced friction over 10 m of the section.

    Over what was driven of it where that is shorter, and over the whole drive where the section was never reached.
    """
    station, friction = truth.station_m, truth.friction_mu
    if inside.sum() > 1:
        station, friction = station[inside], friction[inside]
    # Sideways or backwards the station hardly moves; it must not fall for the integral.
    station = np.maximum.accumulate(station)
    reference = float(friction[0])
    steps = np.diff(station) * 0.5 * (friction[1:] + friction[:-1] - 2.0 * reference)
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    length = min(LABEL_WINDOW_M, float(station[-1] - station[0]))
    if length <= 0.0:
        return float(friction.min())
    starts = np.concatenate([station[station <= station[-1] - length], [station[-1] - length]])
    mean = (np.interp(starts + length, station, integral) - np.interp(starts, station, integral)) / length
    return reference + float(mean.min())


def _share(active: BoolArray, inside: BoolArray) -> float:
    return float(active[inside].mean()) if inside.any() else 0.0


def _peak_ratio(utilisation: FloatArray, inside: BoolArray) -> float:
    values = utilisation[inside]
    width = round(PEAK_WINDOW_S / SAMPLE_S)
    if len(values) < width:
        return 0.0
    return float(np.convolve(values, np.full(width, 1.0 / width), mode="valid").max())
