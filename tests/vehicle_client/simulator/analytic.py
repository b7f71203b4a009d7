"""What theory says of the car: limits of its loaded tyres, the linear single-track model, the shortest stop.

Nothing here calls the simulator; the formulas need the records of car and tyre alone. Accelerations are what the tyres
give per mass of the car, in the plane of the surface, unless said.

References:
    Mitschke and Wallentowitz, Dynamik der Kraftfahrzeuge, part I (braking) and part III (load transfer, single-track
    model). Rill, Road Vehicle Dynamics, chapter 3 (tyre).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadgrip.units import GRAVITY_MPS2, FloatArray
from vehicle_client.simulator.vehicle import XC90, Tyre, Vehicle

LOAD_LIMIT_RATIO = 3.5


def peak_force_n(load_n: FloatArray, *, mu: float, axis: int, tyre: Tyre) -> FloatArray:
    """Return the largest force that tyres give: mu times load times the degression of that axis (0 or 1)."""
    u = np.clip(np.asarray(load_n) / tyre.nominal_load_n, 0.0, LOAD_LIMIT_RATIO)
    ratio = (tyre.peak_x2_ratio / tyre.peak_x1_ratio, tyre.peak_y2_ratio / tyre.peak_y1_ratio)[axis]
    peaks: FloatArray = mu * u * tyre.nominal_load_n * (1.0 + (ratio - 1.0) * (u - 1.0))
    return peaks


def cornering_stiffness_n(load_n: float, tyre: Tyre) -> float:
    """Return the lateral force of one tyre per slip angle at zero slip, N/rad."""
    u = load_n / tyre.nominal_load_n
    return load_n * (tyre.slope_y1_ratio + (tyre.slope_y2_ratio - tyre.slope_y1_ratio) * (u - 1.0))


def roll_arm_m(car: Vehicle) -> float:
    """Return the height of the centre of gravity over the roll axis."""
    axis_m = (car.front_roll_centre_m * car.rear_axle_m + car.rear_roll_centre_m * car.front_axle_m) / car.wheelbase_m
    return car.cog_height_m - axis_m


def steady_roll_rad(force_y_mps2: float, car: Vehicle, *, fall_mps2: float = GRAVITY_MPS2) -> float:
    """Return the roll angle at which springs hold the body; `fall_mps2` is gravity normal to the surface."""
    arm = roll_arm_m(car)
    return car.mass_kg * arm * force_y_mps2 / (car.roll_stiffness_nmprad - car.mass_kg * fall_mps2 * arm)


def steady_loads_n(
    force_y_mps2: float, *, car: Vehicle = XC90, force_x_mps2: float = 0.0, normal_mps2: float = GRAVITY_MPS2
) -> FloatArray:
    """Return the four wheel loads (front left, front right, rear left, rear right) of a steady motion. (4,)

    Args:
        force_y_mps2: What the tyres give to the left.
        car: The car.
        force_x_mps2: What tyres and air give forward.
        normal_mps2: What the wheels bear per mass of the car.
    """
    m, wheelbase = car.mass_kg, car.wheelbase_m
    pitch = m * car.cog_height_m * force_x_mps2 / wheelbase
    roll_nm = car.roll_stiffness_nmprad * steady_roll_rad(force_y_mps2, car)
    side = m * force_y_mps2 / wheelbase
    share = car.front_roll_stiffness_frac
    front = 0.5 * (m * normal_mps2 * car.rear_axle_m / wheelbase - pitch)
    rear = 0.5 * (m * normal_mps2 * car.front_axle_m / wheelbase + pitch)
    to_front = (share * roll_nm + side * car.rear_axle_m * car.front_roll_centre_m) / car.front_track_m
    to_rear = ((1.0 - share) * roll_nm + side * car.front_axle_m * car.rear_roll_centre_m) / car.rear_track_m
    return np.array([front - to_front, front + to_front, rear - to_rear, rear + to_rear])


def lateral_limit_mps2(mu: float, *, car: Vehicle = XC90, cross_slope_ratio: float = 0.0) -> float:
    """Return the largest steady lateral tyre force per mass in a left turn: the first axle has no more to give.

    A bank that rises to the right (negative) presses the car onto the road, as v^2/R has a part normal to the surface.

    Args:
        mu: Friction.
        car: The car.
        cross_slope_ratio: Rise of the surface towards the left.
    """
    fall = GRAVITY_MPS2 / math.hypot(1.0, cross_slope_ratio)

    def spare(force: float) -> float:
        normal = fall - (force - fall * cross_slope_ratio) * cross_slope_ratio
        loads = np.maximum(0.0, steady_loads_n(force, car=car, normal_mps2=normal))
        peaks = peak_force_n(loads, mu=mu, axis=1, tyre=car.tyre)
        need_front = car.mass_kg * force * car.rear_axle_m / car.wheelbase_m
        need_rear = car.mass_kg * force * car.front_axle_m / car.wheelbase_m
        return float(min(peaks[:2].sum() - need_front, peaks[2:].sum() - need_rear))

    return _root(spare, 0.0, 2.0 * mu * GRAVITY_MPS2)


class LongitudinalLimit(NamedTuple):
    """Largest force of all tyres together, each at its peak, and how it is shared.

    Attributes:
        force_mps2: Per mass of the car, positive.
        front_frac: Share of the front axle in it.
    """

    force_mps2: float
    front_frac: float


def longitudinal_limit(
    mu: float, *, braking: bool, speed_mps: float = 0.0, car: Vehicle = XC90, grade_ratio: float = 0.0
) -> LongitudinalLimit:
    """Return the limit of braking or driving straight on with all four tyres at their peak.

    Air drag moves load to the rear, too, and is not part of the result.

    Args:
        mu: Friction.
        braking: Or driving.
        speed_mps: For the drag.
        car: The car.
        grade_ratio: Rise of the surface; it takes from the load.
    """
    normal = GRAVITY_MPS2 / math.hypot(1.0, grade_ratio)
    drag = car.drag_npm2ps2_ratio * speed_mps**2 / car.mass_kg
    sign = -1.0 if braking else 1.0

    def peaks(force: float) -> FloatArray:
        loads = steady_loads_n(0.0, car=car, force_x_mps2=sign * force - drag, normal_mps2=normal)
        return peak_force_n(np.maximum(0.0, loads), mu=mu, axis=0, tyre=car.tyre)

    force = _root(lambda f: float(peaks(f).sum()) - car.mass_kg * f, 0.0, 2.0 * mu * GRAVITY_MPS2)
    each = peaks(force)
    return LongitudinalLimit(force, float(each[:2].sum() / each.sum()))


def ideal_stop_m(mu: float, *, from_mps: float, to_mps: float = 0.0, car: Vehicle = XC90) -> float:
    """Return the shortest way in which speed falls on the level, every tyre at its peak all the time, air helping."""
    speed = np.linspace(to_mps, from_mps, 401)
    rate = np.array(
        [
            longitudinal_limit(mu, braking=True, speed_mps=v, car=car).force_mps2
            + car.drag_npm2ps2_ratio * v**2 / car.mass_kg
            for v in speed
        ]
    )
    return float(np.trapezoid(speed / rate, speed))


def steer_compliance_radpn(car: Vehicle) -> float:
    """Return how much less the front wheels are turned per lateral force of the front axle."""
    return float(getattr(car, "steer_compliance_radpn", 0.0))


def understeer_gradient_s2pm(car: Vehicle) -> float:
    """Return the additional steering per lateral acceleration of the linear car, rad per m/s2.

    The axles' slip per acceleration, (m / L) (b / Cf - a / Cr); what the steering yields; and the yaw moment of
    rolling resistance, which is larger on the loaded side and asks for a difference of the axles' lateral forces.
    """
    front_kg = car.mass_kg * car.rear_axle_m / car.wheelbase_m
    front, rear = _axle_stiffness_n(car)
    slip = front_kg / front - (car.mass_kg - front_kg) / rear
    lean_m = GRAVITY_MPS2 * roll_arm_m(car) * steady_roll_rad(1.0, car)
    transfer_nm = car.mass_kg * (car.cog_height_m + lean_m)
    force = car.tyre.rolling_resistance_ratio * transfer_nm / car.wheelbase_m
    compliance = steer_compliance_radpn(car)
    return slip + force * (1.0 / front + 1.0 / rear) + compliance * (front_kg + force)


def single_track(speed_mps: float, car: Vehicle = XC90) -> tuple[FloatArray, FloatArray]:
    """Return matrix (4, 4) and input (4,) of the linear single-track model on tyres that build up their force.

    States are lateral velocity, yaw rate and the carcass deflection of each axle, with the damping of the carcass;
    the input is the steering angle.

    References:
        Rill, First order tire dynamics, 2006; Pacejka, Tire and Vehicle Dynamics, chapter 1 and 7.
    """
    a, b, m, inertia, v = car.front_axle_m, car.rear_axle_m, car.mass_kg, car.yaw_inertia_kgm2, speed_mps
    carcass, damping = 2.0 * car.tyre.stiffness_y_npm, 2.0 * car.tyre.damping_y_nspm
    front, rear = _axle_stiffness_n(car)
    front /= 1.0 + steer_compliance_radpn(car) * front  # the front wheels yield to their force
    # Columns: the states and the steering.
    system = np.zeros((4, 5))
    for axle, (lever, stiffness) in enumerate(((a, front), (-b, rear))):
        sliding = np.array([1.0, lever, 0.0, 0.0, -v if axle == 0 else 0.0])
        moved = -stiffness / (v * damping + stiffness) * sliding
        moved[2 + axle] = -v * carcass / (v * damping + stiffness)
        force = damping * moved
        force[2 + axle] += carcass
        system[2 + axle] = moved
        system[0] += force / m
        system[1] += lever * force / inertia
    system[0, 1] -= v
    return system[:, :4], system[:, 4]


def single_track_poles_radps(speed_mps: float, car: Vehicle = XC90) -> NDArray[np.complex128]:
    """Return the eigenvalues of the linear single-track model, slowest first. (4,)"""
    poles = np.linalg.eigvals(single_track(speed_mps, car)[0].astype(complex))
    return poles[np.argsort(np.abs(poles))]


def step_response_radps(time_s: FloatArray, *, speed_mps: float, steer_rad: float, car: Vehicle = XC90) -> FloatArray:
    """Return the yaw rate of the linear single-track model after a step of the steering at time zero. (n,)"""
    matrix, drive = single_track(speed_mps, car)
    values, vectors = np.linalg.eig(matrix)
    share = np.linalg.solve(vectors, drive.astype(complex))
    grown = (np.exp(np.outer(time_s, values)) - 1.0) / values * share
    yaw: FloatArray = steer_rad * (grown @ vectors[1]).real
    return yaw


def _axle_stiffness_n(car: Vehicle) -> tuple[float, float]:
    half = 0.5 * car.mass_kg * GRAVITY_MPS2 / car.wheelbase_m
    front = 2.0 * cornering_stiffness_n(half * car.rear_axle_m, car.tyre)
    return front, 2.0 * cornering_stiffness_n(half * car.front_axle_m, car.tyre)


def _root(function, low: float, high: float) -> float:
    """Return where a function that falls through zero does so."""
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) > 0.0 else (low, middle)
    return 0.5 * (low + high)
