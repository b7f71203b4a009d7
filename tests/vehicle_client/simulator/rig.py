"""A test rig: the car alone on an endless surface, and roads made of arcs."""

import numpy as np

from roadgrip.section import build_section
from vehicle_client.simulator import chassis, lanes
from vehicle_client.simulator.plan import NO_SYSTEMS, UNIMPRESSED
from vehicle_client.simulator.seats import place_car
from vehicle_client.simulator.vehicle import XC90


class Rig:
    """The car on a plane of one friction, bank and curvature, with the hands and feet of a machine."""

    def __init__(self, *, speed_mps=20.0, mu=0.8, cross_slope_ratio=0.0, grade_ratio=0.0, step_s=0.002, vehicle=XC90):
        self.step_s = step_s
        self.state = np.zeros(lanes.STATE_SIZE)
        for lane in range(lanes.LANES):
            place_car(self.state, lane, vehicle=vehicle, driver=UNIMPRESSED, stability=NO_SYSTEMS)
        self.of_wheels(lanes.CROSS_SLOPE)[:] = cross_slope_ratio
        self.of_wheels(lanes.GRADE)[:] = grade_ratio
        self.of_wheels(lanes.VELOCITY_X)[:] = speed_mps
        self.of_wheels(lanes.SPIN)[:] = speed_mps / vehicle.tyre.rolling_radius_m
        self.of_wheels(lanes.FRICTION)[:] = mu

    def of_wheels(self, row):
        """Return a row of the first lane, one value per wheel; it may be written."""
        return self.state[row : row + lanes.WHEELS : lanes.LANES]

    def of_body(self, row):
        """Return a value of the first lane."""
        return float(self.state[row])

    def run(self, seconds, *, steer_rad=0.0, steer_rate_radps=0.0, hold_speed_mps=None, brake_nm=0.0, on_circle=False):
        """Drive, and return lateral acceleration, yaw rate and speed at every step."""
        history = np.empty((round(seconds / self.step_s), 3))
        for k in range(len(history)):
            self.of_wheels(lanes.HELD_STEER)[:] = steer_rad + steer_rate_radps * (k + 0.5) * self.step_s
            self.of_wheels(lanes.BRAKE_NM)[:] = brake_nm
            if hold_speed_mps is not None:
                self.of_wheels(lanes.DRIVE_NM)[:] = 2_000.0 * (hold_speed_mps - self.of_body(lanes.VELOCITY_X))
            if on_circle:
                # The surface turns with the car, so that the bank stays across it.
                self.of_wheels(lanes.ANGLE)[:] = 0.0
            chassis.advance(self.state, self.step_s)
            history[k] = [self.of_body(row) for row in (lanes.ACCEL_Y, lanes.YAW_RATE, lanes.VELOCITY_X)]
        return history


def curvy_road(*, radius_m=60.0, speed_mps=18.0, bank_ratio=0.0, mirrored=False, section_id="bend", straight_m=60.0):
    """Return straight, easing, arc of some 100 degrees, easing, straight; left unless mirrored."""
    peak = 1.0 / radius_m
    arc_m, ease_m = 1.6 * radius_m, 40.0
    length = 2.0 * straight_m + 2.0 * ease_m + arc_m
    s = np.linspace(0.0, length, int(length * 10) + 1)
    bends = [straight_m, straight_m + ease_m, straight_m + ease_m + arc_m, straight_m + 2 * ease_m + arc_m]
    curvature = np.interp(s, bends, [0.0, peak, peak, 0.0]) * (-1.0 if mirrored else 1.0)
    step = s[1] - s[0]
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * step)])
    x = np.concatenate([[0.0], np.cumsum(np.cos(0.5 * (heading[1:] + heading[:-1])) * step)])
    y = np.concatenate([[0.0], np.cumsum(np.sin(0.5 * (heading[1:] + heading[:-1])) * step)])
    nodes = np.arange(0, len(s), 50)
    return build_section(
        section_id=section_id,
        name=section_id,
        nodes_m=np.column_stack([x, y, np.zeros_like(x)])[nodes],
        cross_slope_ratio=-np.sign(curvature[nodes]) * bank_ratio * np.abs(curvature[nodes]) / peak,
        speed_limit_mps=speed_mps,
    )
