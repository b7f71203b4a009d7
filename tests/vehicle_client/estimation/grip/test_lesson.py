"""What a passage teaches: sensors that err are found out, and friction is not mistaken for a car."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.section import RoadSection, build_section
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from tests.vehicle_client.estimation.grip.two_axles import HANDLING, NAMES, driven, winding
from vehicle_client.estimation.grip import lesson as lessons
from vehicle_client.estimation.grip.evidence import grip_evidence
from vehicle_client.estimation.grip.lesson import passage_lesson
from vehicle_client.estimation.grip.memory import (
    CONSTANTS,
    COUNT,
    PLACES,
    Lesson,
    handling_with,
    new_memory,
    remembered,
)
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE
from vehicle_client.estimation.grip.recall import Recalled, Sensed, recalled
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.estimation.mounting import InertialSignals
from vehicle_client.estimation.offsets import NO_OFFSETS
from vehicle_client.estimation.vehicle_geometry import XC90

BEST = NAMES.index("grip_all_best_mu")
NEW = new_memory(handling_std_ratio=0.1)
EXACT = new_memory(handling_std_ratio=1e-6)
SPEED_MPS = 15.0


def bend(*, radius_m: float, angle_rad: float = 1.5) -> RoadSection:
    turn = np.linspace(0.0, angle_rad, 60)
    nodes = np.column_stack([abs(radius_m) * np.sin(turn), radius_m * (1.0 - np.cos(turn)), np.zeros_like(turn)])
    return build_section(section_id="bend", name="bend", nodes_m=nodes.tolist(), speed_limit_mps=SPEED_MPS)


def passed(section: RoadSection, *, yaw_scale=1.0, force_offset_mps2=0.0, forward_offset_mps2=0.0) -> Sensed:
    """Return what sensors sense of a steady drive along the middle of a section, with these errors and no others."""
    profile = section.profile
    station = np.arange(0.0, profile.station_m[-1], SPEED_MPS * SAMPLE_S)
    yaw_rate = SPEED_MPS * np.interp(station, profile.station_m, profile.curvature_1pm)
    slope = np.arctan(np.interp(station, profile.station_m, profile.cross_slope_ratio))
    force = SPEED_MPS * yaw_rate + GRAVITY_MPS2 * np.sin(slope)
    lean_ratio = 1.0 + GRAVITY_MPS2 * XC90_HANDLING.roll_gradient_s2pm
    return Sensed(
        section=section,
        measured=InertialSignals(
            accel_x_mps2=np.full(len(station), forward_offset_mps2),
            accel_y_mps2=force * lean_ratio + force_offset_mps2,
            roll_rate_radps=np.zeros(len(station)),
            yaw_rate_radps=yaw_rate * yaw_scale,
        ),
        offsets=NO_OFFSETS,
        station_m=station,
        inside=np.ones(len(station), dtype=bool),
        speed_mps=np.full(len(station), SPEED_MPS),
        steer_rad=np.arctan(XC90.wheelbase_m * yaw_rate / SPEED_MPS),
        wheel_speed_mps=np.full((len(station), 4), SPEED_MPS),
    )


def taught(passages, memory=EXACT):
    for sensed in passages:
        lesson = passage_lesson(
            sensed, friction_mu=0.8, handling=XC90_HANDLING, geometry=XC90, noise=AUTOMOTIVE_NOISE, memory=memory
        )
        memory = remembered(memory, lesson)
    return memory


@pytest.fixture(scope="module")
def bends():
    return [bend(radius_m=radius_m) for radius_m in (80.0, -80.0, 120.0, -60.0, 60.0, -120.0)]


@pytest.fixture
def only_the_map(monkeypatch):
    """Let the map alone teach: tyres of cars that steer without slip are none."""
    monkeypatch.setattr(lessons, "INVERSE_TRUST_RATIO", 1e-12)


@pytest.mark.usefixtures("only_the_map")
@pytest.mark.parametrize(
    ("name", "errors", "truth"),
    [
        ("yaw_rate_scale_ratio", {"yaw_scale": 1.02}, 0.02),
        ("accel_y_offset_mps2", {"force_offset_mps2": 0.15}, 0.15),
        ("accel_x_offset_mps2", {"forward_offset_mps2": -0.2}, -0.2),
    ],
)
def test_the_map_finds_out_which_sensor_errs(bends, name, errors, truth):
    memory = taught([passed(section, **errors) for section in bends] * 3)
    assert memory.value(name) == pytest.approx(truth, rel=0.25)
    for constant, first in zip(CONSTANTS, memory.first_std, strict=True):
        if constant.name != name:
            assert abs(memory.value(constant.name)) < 0.35 * first, constant.name


@pytest.mark.usefixtures("only_the_map")
def test_a_mirrored_life_teaches_mirrored_offsets(bends):
    one = taught([passed(section, force_offset_mps2=0.1, yaw_scale=1.01) for section in bends[:2]])
    mirrored = [bend(radius_m=-radius_m) for radius_m in (80.0, -80.0)]
    other = taught([passed(section, force_offset_mps2=-0.1, yaw_scale=1.01) for section in mirrored])
    assert other.value("accel_y_offset_mps2") == pytest.approx(-one.value("accel_y_offset_mps2"), rel=1e-3)
    assert other.value("yaw_rate_scale_ratio") == pytest.approx(one.value("yaw_rate_scale_ratio"), rel=1e-3)


# The inverse ---------------------------------------------------------------------------------------------------------

FRICTIONS_MU = (0.4, 0.6, 0.9)


@pytest.fixture(scope="module")
def winding_drives():
    asked = [winding(mu, use) for mu, use in zip(FRICTIONS_MU, (0.8, 0.5, 0.3), strict=True)]
    return driven(FRICTIONS_MU, np.column_stack(asked))


def learned_from(motions, handling, *, handling_std_ratio=0.1):
    """Return what is learned of constants by the inverse alone, from cars whose friction nobody tells."""
    memory = new_memory(handling_std_ratio=handling_std_ratio)
    for motion in motions:
        known = recalled_with(motion, handling, memory)
        best = grip_evidence(known.motion, handling=known.handling, geometry=XC90, noise=known.noise)[BEST]
        information, pull = lessons.by_inverse(known, float(best), XC90, memory)
        memory = remembered(memory, Lesson(information, pull))
    return memory


def recalled_with(motion, handling, memory):
    turned = replace(
        motion,
        steer_rad=motion.steer_rad - memory.value("steer_offset_rad"),
        front_wheels_mps=motion.front_wheels_mps / (1.0 + memory.value("front_radius_ratio")),
    )
    return Recalled(turned, handling_with(handling, memory), AUTOMOTIVE_NOISE)


def test_a_steering_that_is_off_is_found_whatever_the_friction(winding_drives):
    off = [replace(motion, steer_rad=motion.steer_rad + 0.8e-3) for motion in winding_drives]
    memory = learned_from(off, HANDLING, handling_std_ratio=1e-4)
    assert memory.value("steer_offset_rad") == pytest.approx(0.8e-3, rel=0.15)


def test_front_wheels_of_another_size_are_found_whatever_the_friction(winding_drives):
    off = [replace(motion, front_wheels_mps=1.002 * motion.front_wheels_mps) for motion in winding_drives]
    memory = learned_from(off, HANDLING, handling_std_ratio=1e-4)
    assert memory.value("front_radius_ratio") == pytest.approx(0.002, rel=0.15)


def test_a_car_that_is_declared_exactly_learns_nothing_wrong(winding_drives):
    memory = learned_from(winding_drives * 2, HANDLING)
    for name in ("stiffness_log_ratio", "peak_slip_log_ratio", "yaw_inertia_log_ratio", "front_drive_log_ratio"):
        assert abs(memory.value(name)) < 0.03, name


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("stiffness_log_ratio", {"stiffness_ratio": 1.1, "stiffness_twice_ratio": 1.1}),
        ("peak_slip_log_ratio", {"peak_slip_ratio": 0.9, "peak_slip_twice_ratio": 0.9}),
    ],
)
def test_a_tyre_that_was_declared_wrong_is_learned_at_several_frictions(winding_drives, name, wrong):
    tyre = replace(HANDLING.tyre, **{key: ratio * getattr(HANDLING.tyre, key) for key, ratio in wrong.items()})
    memory = learned_from(winding_drives * 4, replace(HANDLING, tyre=tyre))
    missing = -np.log(next(iter(wrong.values())))
    assert memory.value(name) == pytest.approx(missing, abs=0.5 * abs(missing))


# Recalling -----------------------------------------------------------------------------------------------------------


def test_who_remembers_nothing_sees_what_was_sensed(bends):
    seen = recalled(passed(bends[0]), handling=XC90_HANDLING, noise=AUTOMOTIVE_NOISE, memory=None)
    assert seen.handling is XC90_HANDLING
    assert seen.noise is AUTOMOTIVE_NOISE
    assert seen.motion.steer_rad.mean() == pytest.approx(np.arctan(XC90.wheelbase_m / 80.0), rel=0.05)


def test_errors_that_are_remembered_are_taken_out(bends):
    mean = np.zeros(COUNT)
    mean[[PLACES["yaw_rate_scale_ratio"], PLACES["accel_x_offset_mps2"]]] = 0.02, -0.2
    known = replace(EXACT, mean=tuple(mean.tolist()))
    wrong = passed(bends[0], yaw_scale=1.02, forward_offset_mps2=-0.2)
    right = recalled(passed(bends[0]), handling=XC90_HANDLING, noise=AUTOMOTIVE_NOISE, memory=EXACT).motion
    seen = recalled(wrong, handling=XC90_HANDLING, noise=AUTOMOTIVE_NOISE, memory=known).motion
    assert seen.yaw_rate_radps == pytest.approx(right.yaw_rate_radps)
    assert seen.force_x_mps2 == pytest.approx(right.force_x_mps2, abs=1e-12)
