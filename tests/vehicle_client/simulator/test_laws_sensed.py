"""What sensors feel is what a rigid body feels that is carried along the road in space: kinematics, done twice."""

import numpy as np
import pytest

from roadgrip.section import build_section
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from tests.vehicle_client.simulator.rig import curvy_road
from vehicle_client.simulator import journey, lanes
from vehicle_client.simulator.plan import ALL_SYSTEMS, UNIMPRESSED, PassagePlan
from vehicle_client.simulator.seats import Lanes
from vehicle_client.simulator.track import TRACK_CROSS_SLOPE, TRACK_GRADE, TRACK_HEADING, track_of
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim

SPEED_MPS = 14.0


def road_in_space(*, mirrored):
    """Return a bend that goes up and down while its bank changes sides."""
    flat = curvy_road(radius_m=60.0, mirrored=mirrored, straight_m=30.0)
    station = np.arange(0.0, flat.length_m, 5.0)
    x, y = (np.interp(station, flat.profile.station_m, line) for line in (flat.profile.x_m, flat.profile.y_m))
    return build_section(
        section_id="in-space",
        name="in space",
        nodes_m=np.column_stack([x, y, 1.5 * np.sin(2.0 * np.pi * station / 110.0)]),
        cross_slope_ratio=0.04 * np.sin(2.0 * np.pi * station / 90.0),
        speed_limit_mps=SPEED_MPS,
    )


def driven(track, *, finish_m):
    """Return the log of a drive over a smooth road. (columns, n)"""
    seats = Lanes()
    rows = {
        lanes.START_M: track.start_m,
        lanes.STEP_M: track.step_m,
        lanes.FINISH_M: finish_m,
        lanes.TARGET_MPS: SPEED_MPS,
        lanes.BRAKE_FROM_M: np.inf,
        lanes.BRAKE_UNTIL_MPS: -1.0,
        lanes.GUESS_MU: 1.2,
    }
    seats.seat(
        seats.free()[0],
        vehicle=XC90,
        driver=UNIMPRESSED,
        stability=ALL_SYSTEMS,
        lines=track.lines,
        rough_m=np.empty((0, 2)),
        samples_limit_count=5_000,
        rows=rows,
    )
    ((_, ending, log),) = seats.drive(journey.STEP_S)
    assert ending == journey.COMPLETED
    return log


def motion_in_space(track, log):
    """Return position, velocity and attitude of the body; its axes are columns. (n, 3), (n, 3), (n, 3, 3)"""
    station = track.start_m + track.step_m * np.arange(len(track.lines))
    at = log[journey.LOG_STATION]
    grade, cross, line_heading = (
        np.interp(at, station, track.lines[:, column]) for column in (TRACK_GRADE, TRACK_CROSS_SLOPE, TRACK_HEADING)
    )
    climbed = np.cumsum(0.5 * (track.lines[1:, TRACK_GRADE] + track.lines[:-1, TRACK_GRADE])) * track.step_m
    offset = log[journey.LOG_OFFSET]
    position = np.column_stack(
        [
            log[journey.LOG_LINE_X] - offset * np.sin(line_heading),
            log[journey.LOG_LINE_Y] + offset * np.cos(line_heading),
            np.interp(at, station, np.concatenate([[0.0], climbed])) + offset * cross,
        ]
    )
    # The surface, and the car's axes on it.
    normal = np.cross(
        np.column_stack([np.cos(line_heading), np.sin(line_heading), grade]),
        np.column_stack([-np.sin(line_heading), np.cos(line_heading), cross]),
    )
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    heading = line_heading + log[journey.LOG_ANGLE]
    level = np.column_stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)])
    forward = level - (normal * level).sum(1)[:, None] / normal[:, 2:] * np.array([0.0, 0.0, 1.0])
    forward /= np.linalg.norm(forward, axis=1)[:, None]
    left = np.cross(normal, forward)
    velocity = forward * log[journey.LOG_VELOCITY_X][:, None] + left * log[journey.LOG_VELOCITY_Y][:, None]
    # The body leans: left side up, then nose down as its springs have answered the longitudinal force.
    roll = log[journey.LOG_ROLL][:, None]
    felt = log[journey.LOG_ACCEL_X] + GRAVITY_MPS2 * (grade * np.cos(heading - line_heading))
    lagged = np.zeros(len(felt))
    for k in range(1, len(felt)):
        lagged[k] = lagged[k - 1] + (felt[k - 1] - lagged[k - 1]) * SAMPLE_S / XC90.load_transfer_lag_s
    pitch = -XC90.pitch_per_accel_s2pm_ratio * lagged[:, None]
    up = normal * np.cos(roll) - left * np.sin(roll)
    left = left * np.cos(roll) + normal * np.sin(roll)
    nose = forward * np.cos(pitch) - up * np.sin(pitch)
    return position, velocity, np.stack([nose, left, up * np.cos(pitch) + forward * np.sin(pitch)], axis=2)


def smooth(values, width=61):
    return np.apply_along_axis(np.convolve, 0, values, np.full(width, 1.0 / width), "same")[width + 200 : -width - 100]


@pytest.fixture(scope="module", params=[False, True])
def in_space(request):
    """Return a log, and position, velocity and attitude of the body in space."""
    section = road_in_space(mirrored=request.param)
    track = track_of(section, PassagePlan(base_friction_mu=0.8, seed=0))
    log = driven(track, finish_m=section.length_m)
    return log, *motion_in_space(track, log)


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


def test_the_car_is_where_its_velocity_takes_it(in_space):
    _, position, velocity, _ = in_space
    assert (rms(smooth(np.gradient(position, SAMPLE_S, axis=0) - velocity)) < 0.003 * SPEED_MPS).all()


def test_the_gyro_senses_how_the_body_turns_in_space(in_space):
    log, _, _, axes = in_space
    spinning = np.einsum("nji,njk->nik", axes, np.gradient(axes, SAMPLE_S, axis=0))
    expected = smooth(np.column_stack([spinning[:, 2, 1], spinning[:, 0, 2], spinning[:, 1, 0]]))
    sensed = smooth(log[journey.LOG_SENSED_RATE : journey.LOG_SENSED_RATE + 3].T)
    assert (rms(sensed - expected) < 0.03 * expected.std(axis=0)).all()


def test_the_accelerometer_senses_how_the_body_moves_in_space_against_gravity(in_space):
    log, _, velocity, axes = in_space
    force = np.gradient(velocity, SAMPLE_S, axis=0) + np.array([0.0, 0.0, GRAVITY_MPS2])
    expected = smooth(np.einsum("nji,nj->ni", axes, force))
    sensed = smooth(log[journey.LOG_SENSED_FORCE : journey.LOG_SENSED_FORCE + 3].T)
    assert (rms(sensed - expected) < 0.03 * expected.std(axis=0)).all()
