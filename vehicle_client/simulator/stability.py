"""ABS, traction control and electronic stability control, each by itself, for all lanes.

They see what production units see: wheel speeds, yaw rate, lateral acceleration, steering angle, the torques they
apply, and from those the force of each tyre; speed and sideslip a real unit estimates. They never know the friction.
Every intervention grows from nothing with what calls for it. Production units switch valves instead; what remains of
that on average is the same, but a drive then hangs on single bits of its past.

ABS and traction control hold a wheel at the slip of the best grip, which lies in proportion to the grip itself: from
the force that the tyre gives they know how much slip it is worth.

References:
    van Zanten, Bosch ESP systems: 5 years of experience, SAE 2000-01-1633 (reference yaw rate, single-wheel braking:
    outer front against oversteer, inner rear against understeer). Savaresi and Tanelli, Active Braking Control Systems
    Design for Vehicles, Springer 2010, chapter 3 (continuous control of slip by the torque of the brake).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from vehicle_client.simulator.compilation import formula
from vehicle_client.simulator.lanes import (
    ABS_ACTIVE,
    ABS_ON,
    ALONG,
    ASKED_BRAKE_NM,
    ASKED_DRIVE_NM,
    BRAKE_NM,
    DRIVE_NM,
    ESC_ACTIVE,
    ESC_ON,
    FORCE_Y,
    GRADIENT,
    LANES,
    LOAD,
    REFERENCE_YAW,
    RELIEF_NM,
    SPIN,
    STEER,
    TCS_ACTIVE,
    TCS_ON,
    VELOCITY_X,
    VELOCITY_Y,
    WANTED_SLIP,
    WHEEL_FORCE_X,
    YAW_RATE,
    ramp_ratio,
    vehicle_at,
)

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

# Yaw control.
_ASLEEP_MPS, _AWAKE_MPS = 3.0, 6.0
_YAW_DEAD_BAND_RADPS = 0.06
_SIDESLIP_DEAD_BAND = 0.07
_YAW_GAIN_NMS = 6_000.0
_SIDESLIP_GAIN_NM = 8_000.0
_UNDERSTEER_SHARE = 0.5
_TORQUE_LIMIT_NM = 1_500.0
_TORQUE_CUT_NM = 300.0
_OVERSTEER_SLIP, _UNDERSTEER_SLIP = 0.4, 0.05
_REFERENCE_LAG_S = 0.08
_MARGIN_MPS2 = 1.0
_NO_TURN_RADPS = 0.02
# Slip control.
_SLIP_PER_GRIP = 0.137
_LEAST_SLIP = 0.015
_SLIP_S = 0.004
_WALKING_MPS, _ROLLING_MPS = 1.0, 2.5
_CREEP_MPS = 0.3
_LEAST_LOAD_N = 500.0
_ACTIVE_NM = 25.0


@formula
def control_yaw(state: FloatArray, lane: int, sample_s: float) -> None:
    """Brake single wheels and cut the engine's torque where the car does not turn as it is steered.

    Args:
        state: Of all lanes; brake and drive torques are changed.
        lane: Which one.
        sample_s: Time since the last call.
    """
    vehicle = vehicle_at(state, lane)
    vx, yaw = state[VELOCITY_X + lane], state[YAW_RATE + lane]
    awake = state[ESC_ON + lane] * ramp_ratio(vx, _ASLEEP_MPS, _AWAKE_MPS)
    speed = max(vx, _ASLEEP_MPS)
    wheelbase = vehicle.front_axle_m + vehicle.rear_axle_m
    asked = speed * state[STEER + lane] / (wheelbase + max(0.0, state[GRADIENT + lane]) * speed * speed)
    state[REFERENCE_YAW + lane] += (asked - state[REFERENCE_YAW + lane]) * sample_s / _REFERENCE_LAG_S
    reference = state[REFERENCE_YAW + lane]
    # More yaw than the present lateral acceleration carries cannot be wanted: beyond it the car would spin.
    carried = (abs(state[FORCE_Y + lane]) + _MARGIN_MPS2) / speed
    wanted = min(max(reference, -carried), carried)
    # One in a left turn and minus one in a right turn, without a jump between.
    turning = yaw / (abs(yaw) + _NO_TURN_RADPS)
    steered = reference / (abs(reference) + _NO_TURN_RADPS)
    excess = max(0.0, turning * (yaw - wanted) - _YAW_DEAD_BAND_RADPS)
    sideslip = max(0.0, -turning * state[VELOCITY_Y + lane] / speed - _SIDESLIP_DEAD_BAND)
    lack = max(0.0, steered * (reference - yaw) - _YAW_DEAD_BAND_RADPS)
    oversteer = min(_YAW_GAIN_NMS * excess + _SIDESLIP_GAIN_NM * sideslip, _TORQUE_LIMIT_NM)
    # Oversteer comes first: against both at once nothing can be done.
    understeer = min(_UNDERSTEER_SHARE * _YAW_GAIN_NMS * lack, _TORQUE_LIMIT_NM)
    understeer *= 1.0 - ramp_ratio(oversteer, 0.0, _TORQUE_CUT_NM)
    oversteer, understeer = awake * oversteer, awake * understeer
    _brake(state, lane, oversteer * max(0.0, -turning), _OVERSTEER_SLIP)
    _brake(state, LANES + lane, oversteer * max(0.0, turning), _OVERSTEER_SLIP)
    _brake(state, 2 * LANES + lane, understeer * max(0.0, steered), _UNDERSTEER_SLIP)
    _brake(state, 3 * LANES + lane, understeer * max(0.0, -steered), _UNDERSTEER_SLIP)
    left = 1.0 - ramp_ratio(oversteer + understeer, 0.0, _TORQUE_CUT_NM)
    _cut(state, lane, left)
    _cut(state, LANES + lane, left)
    _cut(state, 2 * LANES + lane, left)
    _cut(state, 3 * LANES + lane, left)
    state[ESC_ACTIVE + lane] = 1.0 if oversteer + understeer > _ACTIVE_NM else 0.0


@formula
def _brake(state: FloatArray, wheel: int, torque_nm: float, largest_slip: float) -> None:
    # Across its path a wheel needs more slip to brake than ABS would let it have.
    state[ASKED_BRAKE_NM + wheel] += torque_nm
    state[WANTED_SLIP + wheel] = largest_slip * torque_nm / _TORQUE_LIMIT_NM


@formula
def _cut(state: FloatArray, wheel: int, share: float) -> None:
    torque = state[ASKED_DRIVE_NM + wheel]
    state[ASKED_DRIVE_NM + wheel] = min(torque, 0.0) + share * max(torque, 0.0)


@formula
def limit_drive(state: FloatArray, lane: int) -> None:
    """Write the drive torques: what is asked for, but no more than the weaker wheel of an axle can bear.

    Args:
        state: Of all lanes.
        lane: Which one.
    """
    front = min(_bearable_share(state, lane), _bearable_share(state, LANES + lane))
    rear = min(_bearable_share(state, 2 * LANES + lane), _bearable_share(state, 3 * LANES + lane))
    tcs_on = state[TCS_ON + lane]
    front, rear = 1.0 - tcs_on * (1.0 - front), 1.0 - tcs_on * (1.0 - rear)
    cut_nm = max(
        (1.0 - front) * state[ASKED_DRIVE_NM + lane],
        (1.0 - rear) * state[ASKED_DRIVE_NM + 2 * LANES + lane],
    )
    state[TCS_ACTIVE + lane] = 1.0 if cut_nm > _ACTIVE_NM else 0.0
    _drive(state, lane, front)
    _drive(state, LANES + lane, front)
    _drive(state, 2 * LANES + lane, rear)
    _drive(state, 3 * LANES + lane, rear)


@formula
def _drive(state: FloatArray, wheel: int, share: float) -> None:
    torque = state[ASKED_DRIVE_NM + wheel]
    state[DRIVE_NM + wheel] = min(torque, 0.0) + share * max(torque, 0.0)


@formula
def _best_slip_ratio(state: FloatArray, wheel: int) -> float:
    """Return the slip that is worth what the tyre gives; at the best grip it is the tyre's own slip."""
    grip = abs(state[WHEEL_FORCE_X + wheel]) / max(_LEAST_LOAD_N, state[LOAD + wheel])
    slip: float = max(_LEAST_SLIP, _SLIP_PER_GRIP * grip)
    return slip


@formula
def _bearable_share(state: FloatArray, wheel: int) -> float:
    """Return the share of the drive torque that leads a wheel to its best spin: I dw/dt = T - R F."""
    vehicle = vehicle_at(state, wheel)
    radius, rolling = vehicle.tyre.rolling_radius_m, vehicle.tyre.rolling_resistance_ratio
    best_spin = max(0.0, state[ALONG + wheel]) / (1.0 - _best_slip_ratio(state, wheel)) + _CREEP_MPS
    torque = radius * (state[WHEEL_FORCE_X + wheel] + rolling * state[LOAD + wheel])
    torque += vehicle.wheel_inertia_kgm2 * (best_spin / radius - state[SPIN + wheel]) / _SLIP_S
    share: float = min(max(torque, 0.0) / max(1.0, state[ASKED_DRIVE_NM + wheel]), 1.0)
    return share


@formula
def limit_braking(state: FloatArray, wheel: int) -> None:
    """Write the brake torque: what is asked for, but no more than leads the wheel to its best spin.

    Args:
        state: Of all lanes.
        wheel: Which one, of all lanes' wheels.
    """
    vehicle = vehicle_at(state, wheel)
    radius, rolling = vehicle.tyre.rolling_radius_m, vehicle.tyre.rolling_resistance_ratio
    along, asked = state[ALONG + wheel], state[ASKED_BRAKE_NM + wheel]
    slip = max(_best_slip_ratio(state, wheel), state[WANTED_SLIP + wheel])
    best_spin = along / (radius * (1.0 + slip))
    torque = state[DRIVE_NM + wheel] - radius * (state[WHEEL_FORCE_X + wheel] + rolling * state[LOAD + wheel])
    torque -= vehicle.wheel_inertia_kgm2 * (best_spin - state[SPIN + wheel]) / _SLIP_S
    awake = state[ABS_ON + wheel] * ramp_ratio(along, _WALKING_MPS, _ROLLING_MPS)
    relief = awake * max(0.0, asked - max(0.0, torque))
    state[BRAKE_NM + wheel] = asked - relief
    state[RELIEF_NM + wheel] = relief


@formula
def select_low(state: FloatArray, lane: int) -> None:
    """Relieve both rear brakes as much as the weaker wheel needs it: what the other does not brake, it guides.

    Args:
        state: Of all lanes.
        lane: Which one.
    """
    left, right = 2 * LANES + lane, 3 * LANES + lane
    relief = max(state[RELIEF_NM + left], state[RELIEF_NM + right])
    _relieve(state, left, relief)
    _relieve(state, right, relief)


@formula
def _relieve(state: FloatArray, wheel: int, relief_nm: float) -> None:
    state[BRAKE_NM + wheel] = max(0.0, state[ASKED_BRAKE_NM + wheel] - relief_nm)


@formula
def see_braking(state: FloatArray, lane: int) -> None:
    """Write whether any wheel's brake is being released.

    Args:
        state: Of all lanes.
        lane: Which one.
    """
    front = max(state[RELIEF_NM + lane], state[RELIEF_NM + LANES + lane])
    rear = max(state[RELIEF_NM + 2 * LANES + lane], state[RELIEF_NM + 3 * LANES + lane])
    state[ABS_ACTIVE + lane] = 1.0 if max(front, rear) > _ACTIVE_NM else 0.0
