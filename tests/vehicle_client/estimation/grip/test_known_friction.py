"""The friction of a car that was integrated forward is found again, by every channel alone and by all together."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vehicle_client.estimation.grip.two_axles import HANDLING, driven, told_of, winding
from vehicle_client.estimation.grip.motion import silent_without
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, IDEAL_NOISE
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.estimation.vehicle_geometry import XC90

FRICTIONS_MU = (0.15, 0.3, 0.6, 0.9)
USES_RATIO = (0.3, 0.6, 0.9)
CHANNELS = {"all": 0.01, "steering": 0.02, "drift": 0.01, "wheels": 0.06}
"""How far the best friction may be off, in natural logarithms; turned wheels leave the wheel speeds' model first."""
CASES = [(friction_mu, use_ratio) for friction_mu in FRICTIONS_MU for use_ratio in USES_RATIO]


@pytest.fixture(scope="module")
def drives():
    cars = driven(tuple(friction_mu for friction_mu, _ in CASES), np.column_stack([winding(*case) for case in CASES]))
    return dict(zip(CASES, cars, strict=True))


@pytest.mark.parametrize("noise", [AUTOMOTIVE_NOISE, IDEAL_NOISE])
@pytest.mark.parametrize("case", CASES)
def test_a_known_friction_is_found_by_each_channel_and_by_all(drives, case, noise):
    told = told_of(drives[case], noise=noise)
    for channel, tolerance in CHANNELS.items():
        assert np.log(told[f"grip_{channel}_best_mu"] / case[0]) == pytest.approx(0.0, abs=tolerance), channel


@pytest.mark.parametrize("friction_mu", FRICTIONS_MU)
def test_the_more_is_asked_of_the_road_the_better_it_is_known(drives, friction_mu):
    told = [told_of(drives[friction_mu, use_ratio]) for use_ratio in USES_RATIO]
    widths = [told_once["grip_all_below_2sd_ratio"] + told_once["grip_all_above_2sd_ratio"] for told_once in told]
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] < 0.1 * widths[0]


def test_the_same_forces_on_a_road_that_gives_less_are_told_as_less_grip():
    roads = (0.3, 0.4, 0.5, 0.65, 0.8)
    told = [told_of(car) for car in driven(roads, np.column_stack([winding(0.3, 0.85)] * len(roads)))]
    for channel in CHANNELS:
        best = [told_once[f"grip_{channel}_best_mu"] for told_once in told]
        assert best == sorted(best), channel


@pytest.mark.parametrize("channel", ["steering", "drift"])
def test_more_slip_at_the_same_forces_is_never_more_grip(drives, channel):
    motion = drives[0.6, 0.6]
    best = []
    for ratio in (0.9, 1.0, 1.1, 1.2):
        # Wheels that point farther than their axle goes have a larger slip angle; so has a tail that turns out farther.
        slipping = (
            replace(motion, steer_rad=motion.steer_rad * ratio)
            if channel == "steering"
            else replace(motion, yaw_rate_radps=motion.yaw_rate_radps + _turned_in(motion, 0.2 * (ratio - 1.0)))
        )
        best.append(told_of(slipping)[f"grip_{channel}_best_mu"])
    assert best == sorted(best, reverse=True)
    assert best[0] > 1.05 * best[-1]


def _turned_in(motion, angle_per_force_rads2pm):
    return angle_per_force_rads2pm * np.gradient(motion.force_y_mps2, motion.step_s) / 10.0


def test_nothing_tells_more_than_the_peak_of_what_was_asked(drives):
    for case, motion in drives.items():
        told = told_of(motion)
        assert told["demand_q100_mu"] == pytest.approx(case[0] * case[1], rel=0.8)
        use = [told[f"demand_q{level}_use_ratio"] for level in (50, 80, 95, 100)]
        assert use == sorted(use)
        assert use[-1] == pytest.approx(told["demand_q100_mu"] / told["grip_all_best_mu"])
        # What was asked for was there.
        assert told["grip_all_best_mu"] > 0.98 * told["demand_q100_mu"]


def test_noise_of_sensors_shifts_the_best_friction_by_no_more_than_the_distances_say(drives):
    rng = np.random.default_rng(5)
    motion, noise = drives[0.3, 0.9], AUTOMOTIVE_NOISE
    count = len(motion.speed_mps)
    shifts, inside = [], 0
    for _ in range(40):
        heard = replace(
            motion,
            steer_rad=motion.steer_rad
            + noise.steer_offset_rad * rng.normal()
            + noise.steer_rad * rng.normal(size=count),
            force_y_mps2=motion.force_y_mps2 + noise.force_y_mps2 * rng.normal(size=count),
            yaw_rate_radps=motion.yaw_rate_radps + noise.yaw_rate_offset_radps * rng.normal(),
        )
        told = told_of(heard)
        shifts.append(float(np.log(told["grip_all_best_mu"] / 0.3)))
        inside += -told["grip_all_above_2sd_ratio"] <= shifts[-1] <= told["grip_all_below_2sd_ratio"]
    assert abs(np.mean(shifts)) < 0.01
    assert np.std(shifts) < 0.03
    assert inside >= 30


@pytest.mark.parametrize(
    ("absent", "mute"),
    [
        (("roll_rate_radps",), set()),
        (("steer_rad",), {"steering", "wheels"}),
        (("wheel_rear_left_mps",), {"wheels"}),
        (("accel_x_mps2",), {"wheels"}),
        (("accel_y_mps2",), {"all", "steering", "drift", "wheels"}),
        (("yaw_rate_radps",), {"all", "steering", "drift", "wheels"}),
    ],
)
def test_a_channel_whose_sensor_is_absent_says_nothing_and_the_others_what_they_did(drives, absent, mute):
    motion = drives[0.3, 0.9]
    silent = silent_without(absent)
    whole, told = told_of(motion), told_of(replace(motion, silent=silent))
    for channel in CHANNELS:
        below, above = (told[f"grip_{channel}_{side}_1sd_ratio"] for side in ("below", "above"))
        if channel in mute:
            assert below + above > np.log(1.25 / 0.1) - 1e-9
            assert below == pytest.approx(above, abs=0.15)
            assert told[f"grip_{channel}_misfit_ratio"] == 0.0
        elif channel != "all":
            assert told[f"grip_{channel}_best_mu"] == pytest.approx(whole[f"grip_{channel}_best_mu"], rel=1e-9)
        else:
            assert np.log(told["grip_all_best_mu"] / 0.3) == pytest.approx(0.0, abs=CHANNELS["steering"])


def test_a_heavier_car_on_more_tyre_tells_the_same(drives):
    # Everything that has a mass in it times two: nothing but forces change, which nobody senses.
    twice = replace(
        HANDLING,
        mass_kg=2.0 * HANDLING.mass_kg,
        yaw_inertia_kgm2=2.0 * HANDLING.yaw_inertia_kgm2,
        drag_kgpm=2.0 * HANDLING.drag_kgpm,
        tyre=replace(HANDLING.tyre, nominal_load_n=2.0 * HANDLING.tyre.nominal_load_n),
    )
    motion = drives[0.6, 0.6]
    there, here = told_of(motion, handling=twice), told_of(motion)
    # The newton that keeps divisions from nothing does not double.
    assert list(there.values()) == pytest.approx(list(here.values()), rel=5e-3, abs=1e-3)


def test_steering_that_gives_way_is_no_slip(drives):
    motion = drives[0.6, 0.6]
    compliance = XC90_HANDLING.steer_compliance_radpn
    rear_share = XC90.rear_axle_m / XC90.wheelbase_m
    front_n = HANDLING.mass_kg * rear_share * motion.force_y_mps2
    front_n = front_n + HANDLING.yaw_inertia_kgm2 * motion.yaw_accel_radps2 / XC90.wheelbase_m
    giving = replace(motion, steer_rad=motion.steer_rad + compliance * front_n)
    declared = told_of(giving, handling=replace(HANDLING, steer_compliance_radpn=compliance))
    ignored = told_of(giving)
    assert np.log(declared["grip_steering_best_mu"] / 0.6) == pytest.approx(0.0, abs=0.01)
    assert ignored["grip_steering_best_mu"] < 0.95 * declared["grip_steering_best_mu"]
