"""Somebody else's car beside ours: the multi-body model of CommonRoad, and our car with its numbers.

The oracle is `vehicle_dynamics_mb` of the package `commonroad-vehicle-models` (BSD 3-clause, Technical University of
Munich): 29 states, sprung body and two axles joined by compliant joints, Pacejka tyres, integrated by LSODA. It is a
development dependency; nothing that is installed imports it.

`comparable_car` gives our records the oracle's masses, lengths, springs and tyres. Three things of the oracle have no
counterpart in ours, so a `Variant` of it goes without them, and each difference can be laid at somebody's door:

- camber thrust and the offsets of its measured tyre (conicity, ply steer), which step by some 2 % of the wheel load as
  the roll angle changes sign;
- axle masses that weigh on their own axle but turn with the body as if they sat at its centre of gravity. That makes
  its cars understeer a little, although its tyres have no load sensitivity;
- wheels whose contact gives way sideways under load, which lets the body lean a little more.

References:
    Althoff and Würsching, CommonRoad: Vehicle Models, Technical University of Munich, 2020, chapter 9 (multi-body
    model, after the vehicle dynamics simulation of the U.S. Department of Transportation) and tables 6 and 7.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.integrate import ODEintWarning, odeint
from scipy.optimize import least_squares

from roadgrip.units import SAMPLE_S, FloatArray
from vehicle_client.simulator.proving_ground import Plane, drive_open_loop
from vehicle_client.simulator.tyre import steady_force_n
from vehicle_client.simulator.vehicle import XC90, Tyre, Vehicle

HOLD_PER_S = 20.0
"""Acceleration asked for per speed lost, where a machine holds the speed of the oracle."""

# States of the oracle.
STEER, SPEED_X, HEADING, YAW_RATE, ROLL, SPEED_Y = 2, 3, 4, 5, 6, 10
FRONT_Y, REAR_Y, SPINS = 15, 20, slice(23, 27)


class OracleCar(StrEnum):
    """Whose parameters."""

    FORD_ESCORT = "Ford Escort"
    BMW_320I = "BMW 320i"
    VW_VANAGON = "VW Vanagon"


class Variant(StrEnum):
    """How much of the oracle takes part."""

    PUBLISHED = "as published"
    NO_CAMBER = "without camber and tyre offsets"
    PLAIN = "plain"
    """Without all three."""


@dataclass(frozen=True, slots=True)
class Course:
    """What a car did, every 10 ms; ISO 8855 axes. All arrays (n,).

    Attributes:
        time_s: From 0.
        steer_rad: Mean angle of the front wheels.
        velocity_x_mps: At the centre of gravity, forward.
        velocity_y_mps: Left.
        yaw_rate_radps: Left turn positive.
        roll_rad: Of the body against the surface, left side up positive.
        accel_x_mps2: Of the centre of gravity, forward.
        accel_y_mps2: Left.
    """

    time_s: FloatArray
    steer_rad: FloatArray
    velocity_x_mps: FloatArray
    velocity_y_mps: FloatArray
    yaw_rate_radps: FloatArray
    roll_rad: FloatArray
    accel_x_mps2: FloatArray
    accel_y_mps2: FloatArray

    @property
    def sideslip_rad(self) -> FloatArray:
        """Angle of the velocity against the car. (n,)"""
        angle: FloatArray = np.arctan2(self.velocity_y_mps, self.velocity_x_mps)
        return angle


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """Hands and feet of a machine.

    Attributes:
        speed_mps: At the start.
        steer_rad: Every 10 ms. (n,)
        accel_mps2: What the pedals ask for; rolling freely if None. (n,)
        hold_speed: Whether the speed is held by equal torque at all four wheels.
        friction_mu: Peak force over load of our tyre on either axis; that of the oracle's lateral curve if None.
    """

    speed_mps: float
    steer_rad: FloatArray
    accel_mps2: FloatArray | None = None
    hold_speed: bool = False
    friction_mu: float | None = None


def oracle_parameters(
    car: OracleCar, variant: Variant = Variant.PUBLISHED, *, friction_mu: float | None = None, even_drive: bool = False
) -> Any:
    """Return the parameter set of the oracle.

    Args:
        car: Whose parameters.
        variant: How much of the oracle takes part.
        friction_mu: Peak of the lateral tyre curve over load; both peak factors are scaled by it, the slopes are not.
        even_drive: Drive torque at all four wheels in place of the car's own axle.
    """
    from vehiclemodels.parameters_vehicle1 import parameters_vehicle1
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
    from vehiclemodels.parameters_vehicle3 import parameters_vehicle3

    read = {
        OracleCar.FORD_ESCORT: parameters_vehicle1,
        OracleCar.BMW_320I: parameters_vehicle2,
        OracleCar.VW_VANAGON: parameters_vehicle3,
    }[car]
    known = read()
    tyre = known.tire
    if variant is not Variant.PUBLISHED:
        offsets = ("p_hx1", "p_vx1", "p_hy1", "p_hy3", "p_vy1", "p_vy3", "p_dx3", "p_dy3", "r_vy1", "r_vy3", "r_hx1")
        tyre = replace(tyre, **dict.fromkeys(offsets, 0.0))
    if variant is Variant.PLAIN:
        axles = known.m_uf + known.m_ur
        front_frac = known.b / (known.a + known.b)
        known = replace(known, m_uf=front_frac * axles, m_ur=(1.0 - front_frac) * axles, K_lt=0.0)
    if friction_mu is not None:
        scale = friction_mu / tyre.p_dy1
        tyre = replace(tyre, p_dx1=scale * tyre.p_dx1, p_dy1=friction_mu)
    if even_drive:
        known = replace(known, T_se=0.5)
    return replace(known, tire=tyre)


def fitted_tyre(parameters: Any) -> Tyre:
    """Return our tyre with the slopes and peaks of the oracle's, and its way to sliding fitted by least squares.

    The oracle's forces are proportional to the load, so both columns of our tyre are the same; its tyres answer at
    once, so our carcass is stiff.

    Args:
        parameters: The oracle's, at its own friction.
    """
    slip = np.concatenate([np.linspace(0.005, 0.3, 60), np.linspace(0.31, 1.0, 24)])
    load = 3_000.0
    free = XC90.tyre._replace(
        nominal_load_n=load,
        stiffness_x_npm=2e7,
        stiffness_y_npm=2e7,
        damping_x_nspm=0.0,
        damping_y_nspm=0.0,
        rolling_radius_m=parameters.R_w,
        rolling_resistance_ratio=0.0,
        vertical_stiffness_npm=parameters.K_zt,
    )
    for axis, slope, peak in (
        ("x", parameters.tire.p_kx1, parameters.tire.p_dx1),
        ("y", -parameters.tire.p_ky1, parameters.tire.p_dy1),
    ):
        free = _on_axis(free, axis, slope=slope, peak=peak, peak_slip=0.12, slide=0.85 * peak, slide_slip=0.7)
        wanted = np.array([oracle_tyre_force_n(parameters, axis, slip=float(s), load_n=load) for s in slip])

        def misfit(
            x: FloatArray, tyre: Tyre = free, axis: str = axis, peak: float = peak, wanted: FloatArray = wanted
        ) -> FloatArray:
            tried = _on_axis(tyre, axis, peak_slip=x[0], slide=x[1] * peak, slide_slip=x[2])
            ours = [our_tyre_force_n(tried, axis, slip=float(s), load_n=load, friction_mu=peak) for s in slip]
            return np.array(ours) - wanted

        found = least_squares(misfit, [0.12, 0.85, 0.7], bounds=([0.04, 0.3, 0.3], [0.28, 0.99, 5.0])).x
        free = _on_axis(free, axis, peak_slip=found[0], slide=found[1] * peak, slide_slip=found[2])
    return free


def _on_axis(tyre: Tyre, axis: str, **values: float) -> Tyre:
    return tyre._replace(**{f"{name}_{axis}{k}_ratio": float(v) for name, v in values.items() for k in (1, 2)})


def oracle_tyre_force_n(parameters: Any, axis: str, *, slip: float, load_n: float) -> float:
    """Return the magnitude of the oracle's tyre force in pure slip: braking, or to the left.

    Args:
        parameters: The oracle's.
        axis: `x` or `y`.
        slip: Ours, sliding over rolling speed; not negative.
        load_n: Of the wheel.
    """
    from vehiclemodels.utils.tire_model import formula_lateral, formula_longitudinal

    if axis == "x":
        # Theirs is over the speed of the hub: 1 - R w / v, braking positive.
        return -float(formula_longitudinal(slip / (1.0 + slip), 0.0, load_n, parameters.tire))
    return float(formula_lateral(-math.atan(slip), 0.0, load_n, parameters.tire)[0])


def our_tyre_force_n(tyre: Tyre, axis: str, *, slip: float, load_n: float, friction_mu: float) -> float:
    """Return our tyre force in pure slip.

    Args:
        tyre: Ours.
        axis: `x` or `y`.
        slip: Sliding over rolling speed.
        load_n: Of the wheel.
        friction_mu: Peak force over nominal load.
    """
    if axis == "x":
        return float(steady_force_n(slip, 0.0, load_n, friction_mu, tyre)[0])
    return float(steady_force_n(0.0, slip, load_n, friction_mu, tyre)[1])


def comparable_car(parameters: Any) -> Vehicle:
    """Return our car with the numbers of the oracle.

    Its springs stand on soft tyres that roll along, so our roll stiffness is that of both in series; our roll centres
    carry what its axles, whose centres of gravity are at hub height, shift by themselves. Neither car feels air or
    rolling resistance.

    Args:
        parameters: The oracle's, at its own friction.
    """
    p = parameters
    wheelbase = p.a + p.b
    stiffness, damping, centre = [], [], []
    for spring, bar, damper, track, mass, lever in (
        (p.K_sf, p.K_tsf, p.K_sdf, p.T_f, p.m_uf, p.b),
        (p.K_sr, p.K_tsr, p.K_sdr, p.T_r, p.m_ur, p.a),
    ):
        suspension = 0.5 * spring * track**2 - bar
        tyres = 0.5 * p.K_zt * track**2
        share = tyres / (tyres + suspension)
        stiffness.append(share * suspension)
        damping.append(share**2 * 0.5 * damper * track**2)
        centre.append(mass * p.R_w / (p.m * lever / wheelbase))
    arm = p.m_s * p.h_s / p.m
    pitch_nmprad = 2.0 * (p.K_sf * p.a**2 + p.K_sr * p.b**2)
    pitch_nmsprad = 2.0 * (p.K_sdf * p.a**2 + p.K_sdr * p.b**2)
    return _rigid(XC90)._replace(
        mass_kg=p.m,
        yaw_inertia_kgm2=p.I_z,
        roll_inertia_kgm2=p.I_Phi_s,
        front_axle_m=p.a,
        rear_axle_m=p.b,
        front_track_m=p.T_f,
        rear_track_m=p.T_r,
        cog_height_m=arm + (centre[0] * p.b + centre[1] * p.a) / wheelbase,
        front_roll_centre_m=centre[0],
        rear_roll_centre_m=centre[1],
        roll_stiffness_nmprad=sum(stiffness),
        roll_damping_nmsprad=sum(damping),
        front_roll_stiffness_frac=stiffness[0] / sum(stiffness),
        load_transfer_lag_s=pitch_nmsprad / pitch_nmprad,
        wheel_inertia_kgm2=p.I_y_w,
        drag_npm2ps2_ratio=0.0,
        power_w=1e6,
        front_drive_frac=p.T_se,
        front_brake_frac=p.T_sb,
        engine_brake_mps2=0.0,
        brake_limit_mps2=30.0,
        tyre=fitted_tyre(parameters),
    )


def _rigid(vehicle: Vehicle) -> Vehicle:
    """Return the car with a steering that does not give way: the oracle's does not."""
    return vehicle._replace(steer_compliance_radpn=0.0)


def drive_ours(manoeuvre: Manoeuvre, vehicle: Vehicle) -> Course:
    """Return what our car does.

    Args:
        manoeuvre: Hands and feet; its friction must be set.
        vehicle: From `comparable_car`.
    """
    mu = vehicle.tyre.peak_y1_ratio if manoeuvre.friction_mu is None else manoeuvre.friction_mu
    motion = drive_open_loop(
        Plane(friction_mu=mu),
        speed_mps=manoeuvre.speed_mps,
        steer_rad=manoeuvre.steer_rad,
        accel_mps2=manoeuvre.accel_mps2,
        hold_speed=manoeuvre.hold_speed,
        vehicle=vehicle,
    )
    return Course(
        time_s=motion.time_s,
        steer_rad=motion.steer_rad,
        velocity_x_mps=motion.velocity_x_mps,
        velocity_y_mps=motion.velocity_y_mps,
        yaw_rate_radps=motion.yaw_rate_radps,
        roll_rad=motion.roll_rad,
        accel_x_mps2=motion.accel_x_mps2,
        accel_y_mps2=motion.accel_y_mps2,
    )


def right_hand_side(
    manoeuvre: Manoeuvre, parameters: Any, *, exact_steering: bool = True
) -> Callable[[FloatArray, float], list[float]]:
    """Return the oracle's derivative of the state, given the state and the time.

    Args:
        manoeuvre: Hands and feet.
        parameters: From `oracle_parameters`.
        exact_steering: Whether the angle itself is set, besides its rate.
    """
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

    rate = np.diff(manoeuvre.steer_rad, append=manoeuvre.steer_rad[-1]) / SAMPLE_S
    pedals = manoeuvre.accel_mps2
    last = len(rate) - 1

    def derivative(state: FloatArray, time_s: float) -> list[float]:
        k = min(max(int(time_s / SAMPLE_S), 0), last)
        accel = 0.0
        if manoeuvre.hold_speed:
            accel = HOLD_PER_S * (manoeuvre.speed_mps - float(state[SPEED_X]))
        elif pedals is not None:
            accel = float(pedals[k])
        if exact_steering:
            # Their input is the rate of the steering, which jumps every 10 ms; integrated, the angle would drift.
            state[STEER] = manoeuvre.steer_rad[k] + rate[k] * (time_s - k * SAMPLE_S)
        answer: list[float] = vehicle_dynamics_mb(state, [float(rate[k]), accel], parameters)
        return answer

    return derivative


def drive_oracle(manoeuvre: Manoeuvre, parameters: Any) -> Course:
    """Return what the oracle does; cut short where it cannot go on (a wheel that rolls backwards divides by zero).

    Args:
        manoeuvre: Hands and feet. Its friction is in the parameters already.
        parameters: From `oracle_parameters`.
    """
    from vehiclemodels.init_mb import init_mb

    start = init_mb([0.0, 0.0, float(manoeuvre.steer_rad[0]), manoeuvre.speed_mps, 0.0, 0.0, 0.0], parameters)
    derivative = right_hand_side(manoeuvre, parameters)
    time_s = SAMPLE_S * np.arange(len(manoeuvre.steer_rad), dtype=np.float64)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", ODEintWarning)  # where it gives up, the states are not finite
        states = odeint(derivative, start, time_s, rtol=1e-6, atol=1e-6, hmax=SAMPLE_S, mxstep=20_000)
    fine = np.isfinite(states).all(axis=1)
    count = len(states) if fine.all() else int(np.argmin(fine))
    states, time_s = states[:count], time_s[:count]
    # The state may be changed by the model (a wheel that would turn back is stopped), hence the copy.
    with np.errstate(all="ignore"):
        change = np.array([derivative(s.copy(), float(t)) for s, t in zip(states, time_s, strict=True)])
    p = parameters
    across = p.m_s * change[:, SPEED_Y] + p.m_uf * change[:, FRONT_Y] + p.m_ur * change[:, REAR_Y]
    yaw = states[:, YAW_RATE]
    return Course(
        time_s=time_s,
        steer_rad=manoeuvre.steer_rad[:count],
        velocity_x_mps=states[:, SPEED_X],
        velocity_y_mps=states[:, SPEED_Y],
        yaw_rate_radps=yaw,
        roll_rad=-states[:, ROLL],  # its z axis points down
        accel_x_mps2=change[:, SPEED_X] - yaw * states[:, SPEED_Y],
        accel_y_mps2=across / p.m + yaw * states[:, SPEED_X],
    )
