"""What a simulated drive gives back: what the sensors saw, what was true, and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.simulator.plan import PassagePlan


class DriveOutcome(StrEnum):
    """How a drive ended. Only a completed one is a passage; the others are kept apart, never dropped."""

    COMPLETED = "completed"
    LEFT_ROAD = "left_road"
    """The centre of gravity came further from the lane's centre line than `ROAD_MARGIN_M`."""
    SPUN = "spun"
    """The sideslip, or the heading against the road, passed `SPIN_RAD`."""
    STOPPED = "stopped"
    """The vehicle came to a standstill before the end."""
    TIMED_OUT = "timed_out"
    """The drive took longer than any sensible one."""


@dataclass(frozen=True, slots=True)
class Truth:
    """The true motion at the time of every sample of the trace; ISO 8855 axes. All arrays (n,) unless said.

    Attributes:
        time_s: The same as in the trace.
        station_m: Along the section's centre line; negative on the approach, beyond the length on the exit.
        lateral_offset_m: Distance from the centre line, left positive.
        x_m: East of the section's origin.
        y_m: North of it.
        heading_rad: Counter-clockwise from east, unwrapped.
        velocity_x_mps: At the centre of gravity, forward.
        velocity_y_mps: At the centre of gravity, left.
        sideslip_rad: atan2(velocity_y, velocity_x).
        yaw_rate_radps: Left turn positive.
        roll_rad: Of the body against the road surface, left side up positive.
        bank_rad: Of the road surface across the vehicle, left side up positive.
        accel_x_mps2: Acceleration of the centre of gravity in the road plane (gravity is not in it), forward.
        accel_y_mps2: The same, left.
        steer_rad: Mean angle of the front wheels.
        wheel_load_n: Columns as in `vehicle_client.estimation.trace.WHEELS`. (n, 4)
        wheel_force_x_n: Longitudinal tyre force in the wheel's axes. (n, 4)
        wheel_force_y_n: Lateral tyre force in the wheel's axes. (n, 4)
        friction_mu: Friction the four tyres find (surface times wear), weighted by their loads.
        utilisation_ratio: Share of the grip in use: the greater over the two axles of resultant tyre force over
            friction times load.
        abs_active: Where anti-lock braking releases a wheel.
        tcs_active: Where traction control cuts torque.
        esc_active: Where yaw control brakes a wheel or cuts torque.
    """

    time_s: FloatArray
    station_m: FloatArray
    lateral_offset_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    velocity_x_mps: FloatArray
    velocity_y_mps: FloatArray
    sideslip_rad: FloatArray
    yaw_rate_radps: FloatArray
    roll_rad: FloatArray
    bank_rad: FloatArray
    accel_x_mps2: FloatArray
    accel_y_mps2: FloatArray
    steer_rad: FloatArray
    wheel_load_n: FloatArray
    wheel_force_x_n: FloatArray
    wheel_force_y_n: FloatArray
    friction_mu: FloatArray
    utilisation_ratio: FloatArray
    abs_active: BoolArray
    tcs_active: BoolArray
    esc_active: BoolArray


@dataclass(frozen=True, slots=True)
class Drive:
    """One simulated drive, approach and exit included.

    Attributes:
        plan: What was asked for; it and the section reproduce the drive.
        outcome: How it ended. Unless completed, the arrays end where the drive did.
        trace: What the vehicle's sensors saw.
        truth: What was true.
        label_mu: Lowest 10 m moving mean of the load-weighted friction under the tyres inside the section, as far as
            it was driven; on an even road base friction times wear.
        lowest_mu: Lowest single sample of it.
        abs_active_frac: Share of the samples inside the section with anti-lock braking active.
        tcs_active_frac: The same of traction control.
        esc_active_frac: The same of yaw control.
        peak_utilisation_ratio: Largest share of the grip in use inside the section, as 0.1 s means.
        peak_sideslip_rad: Largest magnitude of the sideslip inside the section.
    """

    plan: PassagePlan
    outcome: DriveOutcome
    trace: Trace
    truth: Truth
    label_mu: float
    lowest_mu: float
    abs_active_frac: float
    tcs_active_frac: float
    esc_active_frac: float
    peak_utilisation_ratio: float
    peak_sideslip_rad: float

    @property
    def completed(self) -> bool:
        """Whether the vehicle passed the section and its exit."""
        return self.outcome is DriveOutcome.COMPLETED
