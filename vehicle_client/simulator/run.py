"""The door of the simulator: a section and a plan in, a drive out.

A drive depends on its section and its plan alone: one at a time or in batches, on any number of threads or processes,
it comes out the same to the last bit. Many plans are driven side by side (`lanes`), which takes a tenth of the time;
the compiled part releases the interpreter's lock, so that callers may spread plans over threads as well as over
processes. This module starts neither.

The first call on a machine compiles for some seconds (`warm_up` does nothing else); later processes read the compiler's
cache.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.geodesy import frame_of
from roadgrip.section import build_section
from roadgrip.units import PASCAL_PER_BAR, SAMPLE_S, FloatArray
from vehicle_client.simulator import journey
from vehicle_client.simulator.drive import Drive, DriveOutcome, Truth
from vehicle_client.simulator.driver import SURE_MU
from vehicle_client.simulator.lanes import (
    APPROACH_M,
    BRAKE_FROM_M,
    BRAKE_MPS2,
    BRAKE_UNTIL_MPS,
    FINISH_M,
    GUESS_MU,
    START_M,
    STEP_M,
    TARGET_MPS,
)
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
from vehicle_client.simulator.seats import Lanes
from vehicle_client.simulator.sensors import SENSORS, Motion, gnss_track, scaled, trace_of
from vehicle_client.simulator.surface import class_density_m3, roughness_m
from vehicle_client.simulator.track import Track, bare_track_of, with_friction

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

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
    "each_passage",
    "simulate_passage",
    "simulate_passages",
    "warm_up",
]

LABEL_WINDOW_M = 10.0
PEAK_WINDOW_S = 0.1
_WAITING_LIMIT = 64
"""Drives that are done but not yet their turn; beyond it no further ones set off."""
_SURFACE, _SENSORS, _GNSS = 0, 1, 2
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
    return next(each_passage(section, [plan], step_s=step_s))


def simulate_passages(section: RoadSection, plans: Iterable[PassagePlan]) -> list[Drive]:
    """Return the drives of many plans, in their order; each is what `simulate_passage` returns for it.

    All drives with their full histories are in memory at once; `each_passage` keeps but a few.

    Args:
        section: The road.
        plans: Everything else.

    Raises:
        SectionError: As `simulate_passage`.
        ValueError: As `simulate_passage`.
    """
    return list(each_passage(section, plans))


def each_passage(
    section: RoadSection, plans: Iterable[PassagePlan], *, step_s: float = journey.STEP_S
) -> Iterator[Drive]:
    """Yield the drives of many plans, in their order, with little more than a dozen in memory.

    Args:
        section: The road.
        plans: Everything else; read as lanes become free.
        step_s: Time step of the cars.

    Raises:
        SectionError: As `simulate_passage`.
        ValueError: As `simulate_passage`.
    """
    lanes = Lanes()
    bare_track = lru_cache(maxsize=8)(
        lambda approach_m, exit_m: bare_track_of(section, approach_m=approach_m, exit_m=exit_m)
    )
    coming = enumerate(plans)
    seated: dict[int, tuple[int, PassagePlan]] = {}
    done: dict[int, Drive] = {}
    due = 0
    while True:
        # Who waits for a slow drive ahead of him waits in memory: then nobody else sets off.
        for lane in lanes.free() if len(done) < _WAITING_LIMIT else ():
            number, plan = next(coming, (-1, None))
            if plan is None:
                break
            _check(section, plan)
            _seat(lanes, lane, section, plan, with_friction(bare_track(plan.approach_m, plan.exit_m), plan))
            seated[lane] = number, plan
        if not seated:
            return
        for lane, ending, log in lanes.drive(step_s):
            number, plan = seated.pop(lane)
            done[number] = _drive_of(section, plan, log, _OUTCOMES[ending])
        while due in done:
            yield done.pop(due)
            due += 1


def _seat(lanes: Lanes, lane: int, section: RoadSection, plan: PassagePlan, track: Track) -> None:
    surface_rng = _rng_of(plan, _SURFACE)
    rough = np.empty((0, 2))
    if plan.roughness is not None:
        rough = roughness_m(
            surface_rng,
            length_m=track.length_m + track.step_m,
            density_m3=plan.scales.roughness_ratio**2 * class_density_m3(plan.roughness),
        )
    target_mps = section.speed_limit_mps if plan.target_speed_mps is None else plan.target_speed_mps
    finish_m = section.length_m + plan.exit_m
    longest_s = (plan.approach_m + finish_m) / journey.SLOWEST_MEAN_MPS + 10.0
    lanes.seat(
        lane,
        vehicle=plan.vehicle,
        driver=plan.driver,
        stability=plan.stability,
        lines=track.lines,
        rough_m=rough,
        samples_limit_count=int(longest_s / SAMPLE_S),
        rows={
            START_M: track.start_m,
            STEP_M: track.step_m,
            APPROACH_M: plan.approach_m,
            FINISH_M: finish_m,
            TARGET_MPS: target_mps,
            BRAKE_FROM_M: np.inf if plan.braking is None else plan.braking.station_m,
            BRAKE_MPS2: 0.0 if plan.braking is None else plan.braking.decel_mps2,
            BRAKE_UNTIL_MPS: -1.0 if plan.braking is None else plan.braking.end_speed_mps,
            GUESS_MU: min(SURE_MU, plan.driver.friction_guess_mu),
        },
    )


def _rng_of(plan: PassagePlan, purpose: int) -> np.random.Generator:
    """Return the source of chance of one purpose; the same as that of a seed sequence's child of this number."""
    return np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(purpose,)))


def _drive_of(section: RoadSection, plan: PassagePlan, log: FloatArray, outcome: DriveOutcome) -> Drive:
    truth = _truth(log)
    sensors = scaled(SENSORS[plan.sensor_grade], plan.scales.sensors_ratio)
    gnss = None
    if plan.with_gnss:
        rng = _rng_of(plan, _GNSS)
        gnss = gnss_track(truth.x_m, truth.y_m, frame=frame_of(section), rng=rng, sensors=sensors)
    car_rng = None if plan.sensor_seed is None else np.random.default_rng(plan.sensor_seed)
    trace = trace_of(_motion(log), rng=_rng_of(plan, _SENSORS), sensors=sensors, gnss=gnss, car_rng=car_rng)
    inside = (truth.station_m >= 0.0) & (truth.station_m <= section.length_m)
    seen = inside if inside.any() else np.ones_like(inside)
    return Drive(
        plan=plan,
        outcome=outcome,
        trace=trace,
        truth=truth,
        label_mu=_lowest_moving_mean_mu(truth, inside),
        lowest_mu=float(truth.friction_mu[seen].min()),
        abs_active_frac=_share(truth.abs_active, inside),
        tcs_active_frac=_share(truth.tcs_active, inside),
        esc_active_frac=_share(truth.esc_active, inside),
        peak_utilisation_ratio=_peak_ratio(truth.utilisation_ratio, inside),
        peak_sideslip_rad=float(np.abs(truth.sideslip_rad[inside]).max()) if inside.any() else 0.0,
    )


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
    if not 150_000.0 <= plan.pressure_pa <= 350_000.0:
        message = f"a tyre pressure of {plan.pressure_pa / PASCAL_PER_BAR:g} bar is not between 1.5 and 3.5"
        raise ValueError(message)
    if not all(0.0 <= ratio <= 10.0 for ratio in plan.scales):
        message = f"disturbances {plan.scales} times as large as usual are beyond all measure"
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


def _truth(log: FloatArray) -> Truth:
    """Return what was true; most of it are views of the log."""
    offset, line_heading = log[journey.LOG_OFFSET], log[journey.LOG_LINE_HEADING]
    vx, vy = log[journey.LOG_VELOCITY_X], log[journey.LOG_VELOCITY_Y]
    return Truth(
        time_s=SAMPLE_S * np.arange(log.shape[1], dtype=np.float64),
        station_m=log[journey.LOG_STATION],
        lateral_offset_m=offset,
        x_m=log[journey.LOG_LINE_X] - offset * np.sin(line_heading),
        y_m=log[journey.LOG_LINE_Y] + offset * np.cos(line_heading),
        heading_rad=line_heading + log[journey.LOG_ANGLE],
        velocity_x_mps=vx,
        velocity_y_mps=vy,
        sideslip_rad=np.arctan2(vy, vx),
        yaw_rate_radps=log[journey.LOG_YAW_RATE],
        roll_rad=log[journey.LOG_ROLL],
        bank_rad=log[journey.LOG_BANK],
        accel_x_mps2=log[journey.LOG_ACCEL_X],
        accel_y_mps2=log[journey.LOG_ACCEL_Y],
        steer_rad=log[journey.LOG_STEER],
        wheel_load_n=log[journey.LOG_LOAD : journey.LOG_LOAD + 4].T,
        wheel_force_x_n=log[journey.LOG_FORCE_X : journey.LOG_FORCE_X + 4].T,
        wheel_force_y_n=log[journey.LOG_FORCE_Y : journey.LOG_FORCE_Y + 4].T,
        friction_mu=log[journey.LOG_FRICTION],
        utilisation_ratio=log[journey.LOG_UTILISATION],
        abs_active=log[journey.LOG_ABS] > 0.0,
        tcs_active=log[journey.LOG_TCS] > 0.0,
        esc_active=log[journey.LOG_ESC] > 0.0,
    )


def _motion(log: FloatArray) -> Motion:
    """Return what sensors sense: the motion in the axes of the body, which leans against the road."""
    stability: BoolArray = log[journey.LOG_ABS : journey.LOG_ESC + 1].max(axis=0) > 0.0
    return Motion(
        specific_force_mps2=np.ascontiguousarray(log[journey.LOG_SENSED_FORCE : journey.LOG_SENSED_FORCE + 3].T),
        rate_radps=np.ascontiguousarray(log[journey.LOG_SENSED_RATE : journey.LOG_SENSED_RATE + 3].T),
        steer_rad=log[journey.LOG_STEER],
        wheel_speed_mps=np.ascontiguousarray(log[journey.LOG_WHEEL_SPEED : journey.LOG_WHEEL_SPEED + 4].T),
        stability_active=stability,
    )


def _lowest_moving_mean_mu(truth: Truth, inside: BoolArray) -> float:
    """Return the lowest mean of the experienced friction over 10 m of the section.

    Over what was driven of it where that is shorter, and over the whole drive where the section was never reached.
    """
    station, friction = truth.station_m, truth.friction_mu
    if np.count_nonzero(inside) > 1:
        station, friction = station[inside], friction[inside]
    if friction.min() == friction.max():
        return float(friction[0])
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
    sums = np.concatenate([[0.0], np.cumsum(values)])
    return float((sums[width:] - sums[:-width]).max()) / width
