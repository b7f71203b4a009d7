"""Cars side by side: the state of many drives in one array, so that one instruction moves several of them.

A *lane* is one of `LANES` drives that are simulated together; it has nothing to do with the lanes of a road. The state
is one flat array of rows. A row holds one quantity: of the front left wheels of all lanes, then of the front right,
the rear left and the rear right ones. What a car has once uses the first `LANES` places of its row. So

    state[LOAD + place]            for place in range(WHEELS)    loops over all wheels of all cars,
    state[YAW_RATE + lane]         for lane in range(LANES)      loops over all cars,
    state[LOAD + 2 * LANES + lane]                               is the load of one rear left wheel,

and in each such loop neighbours in memory undergo the same arithmetic, which the compiler turns into vector
instructions. For that the loops hold no branches (both sides are computed, one is chosen) and no calls that the
compiler cannot put in place. Because rows are as long as the loops, no lane's result depends on which lane it is or on
what the others do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from vehicle_client.simulator.compilation import INTERPRETED, formula
from vehicle_client.simulator.plan import Driver
from vehicle_client.simulator.vehicle import Tyre, Vehicle

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

LANES: Final = 1 if INTERPRETED else 16
"""Two of the widest vector registers there are: loops of one alone the compiler unrolls instead."""
WHEELS: Final = 4 * LANES
"""Length of a row."""


def rows(first_row: int, rows_count: int) -> tuple[int, ...]:
    """Return where rows start in the state."""
    return tuple(WHEELS * (first_row + i) for i in range(rows_count))


# What a drive is given: constant while it lasts. One row per field of the record of that name.
VEHICLE = 0
TYRE = VEHICLE + WHEELS * (len(Vehicle._fields) - 1)  # a vehicle's last field is its tyre
DRIVER = TYRE + WHEELS * len(Tyre._fields)
_GIVEN_ROWS = (DRIVER + WHEELS * len(Driver._fields)) // WHEELS
(
    START_M,  # station of the first row of the road's table
    STEP_M,  # between its rows
    APPROACH_M,  # the drive starts at the negative of this station
    FINISH_M,  # station where it is complete
    BRAKE_FROM_M,  # station where he is ordered to brake; infinite if he is not
    BRAKE_MPS2,  # deceleration that the order asks for
    BRAKE_UNTIL_MPS,  # speed at which it is fulfilled
    ABS_ON,  # one with anti-lock braking, zero without
    TCS_ON,  # the same for traction control
    ESC_ON,  # the same for yaw control
    GRADIENT,  # understeer gradient of the car, rad per m/s2
    LEVER_X,  # of each wheel, from the centre of gravity forward
    LEVER_Y,  # and to the left
) = rows(_GIVEN_ROWS, 13)
_ROAD_ROW = _GIVEN_ROWS + 13

# The road under the car, and by how much it changes per time step.
(
    CURVATURE,
    GRADE,
    CROSS_SLOPE,
    GRADE_CHANGE,
    CROSS_CHANGE,
    FRICTION,
    CURVATURE_STEP,
    GRADE_STEP,
    CROSS_SLOPE_STEP,
    GRADE_CHANGE_STEP,
    CROSS_CHANGE_STEP,
    FRICTION_STEP,
    ROAD_Z,
    LINE_X,
    LINE_Y,
    LINE_HEADING,
) = rows(_ROAD_ROW, 16)
_BODY_ROW = _ROAD_ROW + 16

# The body.
(
    VELOCITY_X,
    VELOCITY_Y,
    YAW_RATE,
    ROLL,
    ROLL_RATE,
    STATION,
    OFFSET,
    ANGLE,
    PACE,  # change of station per second
    FORCE_X,  # specific, of tyres and air: the accelerometer's share in the road plane
    FORCE_Y,
    LAGGED_X,  # specific force as the springs have answered it
    ACCEL_X,
    ACCEL_Y,
    DRIFT_X,  # change of the velocities per second, in axes that turn with the car
    DRIFT_Y,
    DRIFT_YAW,
    STEER,  # mean angle of the front wheels, as steering wheel and rack ask for it
    HELD_STEER,  # the same in the middle of the time step
    YIELDED,  # by how much they give way to the tyres' lateral force
) = rows(_BODY_ROW, 20)
_WHEEL_ROW = _BODY_ROW + 20

# The wheels.
(
    SPIN,
    SPIN_DRIFT,  # its change per second as a free wheel would follow the body
    BRISTLE_X,
    BRISTLE_Y,
    LOAD,
    WHEEL_FORCE_X,
    WHEEL_FORCE_Y,
    SLIP_X,
    SLIDE,  # slip over the slip of the peak
    DRIVE_NM,
    BRAKE_NM,
    ASKED_DRIVE_NM,  # by pedals and yaw control, before the slip is limited
    ASKED_BRAKE_NM,
    WANTED_SLIP,  # what yaw control lets a wheel slip at least
    RELIEF_NM,  # brake torque that ABS takes away
    SPRUNG_Z,
    SPRUNG_V,
    UNSPRUNG_Z,
    UNSPRUNG_V,
    ALONG,  # velocity of the hub in the wheel's plane
    ACROSS,  # and across it
    COSINE,  # of the wheel's angle
    SINE,
) = rows(_WHEEL_ROW, 23)
_MIND_ROW = _WHEEL_ROW + 23

# What goes on in the driver's head, and in the control unit.
(
    GUESS_MU,
    FELT_SLIDE,
    FELT_FORCE,
    ALLOWED_MPS,  # speed that the road ahead allows, when he last looked
    NEEDED_MPS2,  # deceleration that it asked for
    AHEAD_CURVATURE,
    AHEAD_CROSS_SLOPE,
    ACCEL_WISH,
    STEER_WISH,
    TARGET_MPS,  # speed he likes where nothing holds him back
    ORDERED,  # one while he obeys the order to brake, zero otherwise
    PEDALS_MPS2,  # the wish as brakes and engine answer it
    REFERENCE_YAW,
    ABS_ACTIVE,
    TCS_ACTIVE,
    ESC_ACTIVE,
) = rows(_MIND_ROW, 16)
_REPORT_ROW = _MIND_ROW + 16

# The report: what is logged every sample, in rows of its own and in the order of the log's columns.
REPORT_COUNT: Final = 41
REPORT = WHEELS * _REPORT_ROW
STATE_SIZE = WHEELS * (_REPORT_ROW + REPORT_COUNT)


@formula
def vehicle_at(state: FloatArray, place: int) -> Vehicle:
    """Return the car of a lane; reading only some of its fields costs only those.

    Args:
        state: Of all lanes.
        place: A lane, or any of its wheels.
    """
    return Vehicle(
        mass_kg=state[VEHICLE + place],
        yaw_inertia_kgm2=state[VEHICLE + 1 * WHEELS + place],
        roll_inertia_kgm2=state[VEHICLE + 2 * WHEELS + place],
        front_axle_m=state[VEHICLE + 3 * WHEELS + place],
        rear_axle_m=state[VEHICLE + 4 * WHEELS + place],
        front_track_m=state[VEHICLE + 5 * WHEELS + place],
        rear_track_m=state[VEHICLE + 6 * WHEELS + place],
        cog_height_m=state[VEHICLE + 7 * WHEELS + place],
        front_roll_centre_m=state[VEHICLE + 8 * WHEELS + place],
        rear_roll_centre_m=state[VEHICLE + 9 * WHEELS + place],
        roll_stiffness_nmprad=state[VEHICLE + 10 * WHEELS + place],
        roll_damping_nmsprad=state[VEHICLE + 11 * WHEELS + place],
        front_roll_stiffness_frac=state[VEHICLE + 12 * WHEELS + place],
        pitch_per_accel_s2pm_ratio=state[VEHICLE + 13 * WHEELS + place],
        load_transfer_lag_s=state[VEHICLE + 14 * WHEELS + place],
        wheel_inertia_kgm2=state[VEHICLE + 15 * WHEELS + place],
        unsprung_mass_kg=state[VEHICLE + 16 * WHEELS + place],
        wheel_rate_npm=state[VEHICLE + 17 * WHEELS + place],
        damper_nspm=state[VEHICLE + 18 * WHEELS + place],
        drag_npm2ps2_ratio=state[VEHICLE + 19 * WHEELS + place],
        power_w=state[VEHICLE + 20 * WHEELS + place],
        front_drive_frac=state[VEHICLE + 21 * WHEELS + place],
        front_brake_frac=state[VEHICLE + 22 * WHEELS + place],
        engine_brake_mps2=state[VEHICLE + 23 * WHEELS + place],
        brake_limit_mps2=state[VEHICLE + 24 * WHEELS + place],
        brake_lag_s=state[VEHICLE + 25 * WHEELS + place],
        steer_limit_rad=state[VEHICLE + 26 * WHEELS + place],
        steer_rate_limit_radps=state[VEHICLE + 27 * WHEELS + place],
        steer_compliance_radpn=state[VEHICLE + 28 * WHEELS + place],
        steer_compliance_lag_s=state[VEHICLE + 29 * WHEELS + place],
        tyre=tyre_at(state, place),
    )


@formula
def tyre_at(state: FloatArray, place: int) -> Tyre:
    """Return the tyre of a lane.

    Args:
        state: Of all lanes.
        place: A lane, or any of its wheels.
    """
    return Tyre(
        nominal_load_n=state[TYRE + place],
        slope_x1_ratio=state[TYRE + 1 * WHEELS + place],
        slope_x2_ratio=state[TYRE + 2 * WHEELS + place],
        peak_x1_ratio=state[TYRE + 3 * WHEELS + place],
        peak_x2_ratio=state[TYRE + 4 * WHEELS + place],
        peak_slip_x1_ratio=state[TYRE + 5 * WHEELS + place],
        peak_slip_x2_ratio=state[TYRE + 6 * WHEELS + place],
        slide_x1_ratio=state[TYRE + 7 * WHEELS + place],
        slide_x2_ratio=state[TYRE + 8 * WHEELS + place],
        slide_slip_x1_ratio=state[TYRE + 9 * WHEELS + place],
        slide_slip_x2_ratio=state[TYRE + 10 * WHEELS + place],
        slope_y1_ratio=state[TYRE + 11 * WHEELS + place],
        slope_y2_ratio=state[TYRE + 12 * WHEELS + place],
        peak_y1_ratio=state[TYRE + 13 * WHEELS + place],
        peak_y2_ratio=state[TYRE + 14 * WHEELS + place],
        peak_slip_y1_ratio=state[TYRE + 15 * WHEELS + place],
        peak_slip_y2_ratio=state[TYRE + 16 * WHEELS + place],
        slide_y1_ratio=state[TYRE + 17 * WHEELS + place],
        slide_y2_ratio=state[TYRE + 18 * WHEELS + place],
        slide_slip_y1_ratio=state[TYRE + 19 * WHEELS + place],
        slide_slip_y2_ratio=state[TYRE + 20 * WHEELS + place],
        stiffness_x_npm=state[TYRE + 21 * WHEELS + place],
        stiffness_y_npm=state[TYRE + 22 * WHEELS + place],
        damping_x_nspm=state[TYRE + 23 * WHEELS + place],
        damping_y_nspm=state[TYRE + 24 * WHEELS + place],
        rolling_radius_m=state[TYRE + 25 * WHEELS + place],
        rolling_resistance_ratio=state[TYRE + 26 * WHEELS + place],
        vertical_stiffness_npm=state[TYRE + 27 * WHEELS + place],
    )


@formula
def driver_at(state: FloatArray, place: int) -> Driver:
    """Return the driver of a lane.

    Args:
        state: Of all lanes.
        place: A lane.
    """
    return Driver(
        friction_guess_mu=state[DRIVER + place],
        grip_share_ratio=state[DRIVER + 1 * WHEELS + place],
        comfort_accel_mps2=state[DRIVER + 2 * WHEELS + place],
        braking_mps2=state[DRIVER + 3 * WHEELS + place],
        sight_m=state[DRIVER + 4 * WHEELS + place],
        preview_s=state[DRIVER + 5 * WHEELS + place],
        steer_lag_s=state[DRIVER + 6 * WHEELS + place],
        yaw_damping_s_ratio=state[DRIVER + 7 * WHEELS + place],
        slide_feeling_ratio=state[DRIVER + 8 * WHEELS + place],
    )


@formula
def ramp_ratio(value: float, low: float, high: float) -> float:
    """Return zero below `low`, one above `high` and a straight line between: a switch without a jump."""
    return min(max((value - low) / (high - low), 0.0), 1.0)
