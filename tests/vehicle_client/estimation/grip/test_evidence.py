"""What is sent: numbers within the table's ranges whatever is sensed, and nothing told where nothing was asked."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.features import GRIP_SHAPES, GRIP_TABLE, PROFILE_FLOOR, PROFILE_FRICTIONS_MU
from tests.vehicle_client.estimation.grip.two_axles import NAMES, driven, mirrored_motion, told_of, winding
from vehicle_client.estimation.grip.evidence import COARSE_MU
from vehicle_client.estimation.grip.noise import IDEAL_NOISE

GRID_WIDTH = float(np.log(COARSE_MU[-1] / COARSE_MU[0]))
FEATURES = {name: GRIP_TABLE.features[GRIP_TABLE.index(name)] for name in NAMES}
SIGNALS = {
    "speed_mps": 60.0,
    "yaw_rate_radps": 3.0,
    "yaw_accel_radps2": 30.0,
    "steer_rad": 0.7,
    "force_x_mps2": 20.0,
    "force_y_mps2": 30.0,
    "force_y_rate_mps3": 300.0,
    "normal_mps2": 30.0,
    "bank_rad": 0.3,
    "front_wheels_mps": 80.0,
    "rear_wheels_mps": 80.0,
}
"""The largest that anything sensed may be here, far beyond what a car does."""
FLOORS = {"speed_mps": 2.0, "normal_mps2": 3.0, "front_wheels_mps": 0.0, "rear_wheels_mps": 0.0}


@pytest.fixture(scope="module")
def motion():
    return driven((0.5,), winding(0.5, 0.8)[:, None])[0]


def told_within(told):
    """Return the features that are not numbers within the table's range."""
    return [
        name
        for name, value in told.items()
        if name in FEATURES and not (np.isfinite(value) and FEATURES[name].minimum <= value <= FEATURES[name].maximum)
    ]


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), share=st.sampled_from([0.02, 0.3, 1.0]))
def test_whatever_is_sensed_the_figures_are_within_their_ranges(motion, seed, count, share):
    rng = np.random.default_rng(seed)
    sensed = {
        name: rng.uniform(
            FLOORS[name] if name in FLOORS else -share * largest, FLOORS.get(name, 0) + share * largest, count
        )
        for name, largest in SIGNALS.items()
    }
    inside = rng.random(count) < 0.7
    inside[0] = True
    absurd = replace(motion, inside=inside, counted_weight=np.where(inside, 0.5, 0.0), **sensed)
    assert not told_within(told_of(absurd))


def still(motion, *, count=120, **signals):
    """Return a motion straight on, with nothing but what is said."""
    nothing = {name: np.full(count, FLOORS.get(name, 0.0)) for name in SIGNALS}
    nothing |= {name: np.full(count, 9.81 if name == "normal_mps2" else 20.0) for name in FLOORS}
    return replace(
        motion, inside=np.ones(count, dtype=bool), counted_weight=np.full(count, 0.5), **{**nothing, **signals}
    )


@pytest.mark.parametrize("noise", [None, IDEAL_NOISE])
def test_a_straight_road_tells_nothing(motion, noise):
    told = told_of(still(motion)) if noise is None else told_of(still(motion), noise=noise)
    for channel in GRIP_SHAPES:
        width = told[f"grip_{channel}_below_1sd_ratio"] + told[f"grip_{channel}_above_1sd_ratio"]
        assert width > GRID_WIDTH - 1e-9, channel
    profile = [told[f"grip_profile_{100 * friction_mu:.0f}_ratio"] for friction_mu in PROFILE_FRICTIONS_MU]
    assert profile == pytest.approx(np.zeros(len(profile)), abs=0.1)
    assert told["force_y_max_mps2"] == told["yaw_rate_max_radps"] == 0.0


def test_a_car_that_starts_from_standstill_tells_numbers(motion):
    count = 120
    speed = np.maximum(2.0, 0.15 * np.arange(count))
    starting = still(
        motion,
        speed_mps=speed,
        front_wheels_mps=0.15 * np.arange(count),
        rear_wheels_mps=0.15 * np.arange(count),
        force_x_mps2=np.full(count, 1.5),
    )
    assert not told_within(told_of(starting))


def test_one_sample_is_enough_to_answer(motion):
    one = {
        of.name: getattr(motion, of.name)[40:41]
        for of in fields(motion)
        if isinstance(getattr(motion, of.name), np.ndarray)
    }
    told = told_of(replace(motion, **one))
    assert not told_within(told)
    assert told["grip_drift_misfit_ratio"] == pytest.approx(0.0, abs=1e-12)
    assert told["demand_q50_use_ratio"] == told["demand_q100_use_ratio"] > 0.0


def test_samples_outside_the_section_change_nothing_that_was_asked(motion):
    inside = motion.inside.copy()
    inside[:60] = inside[-60:] = False
    here = replace(motion, inside=inside, counted_weight=np.where(inside, 0.5, 0.0))
    wild = replace(here, force_x_mps2=np.where(inside, here.force_x_mps2, 3.0))
    before, after = told_of(here), told_of(wild)
    for name in before:
        # What is told as a share of the best of all channels goes with the drift, whose slow part reaches out.
        of_the_best = name.endswith(("_shift_ratio", "_use_ratio"))
        asked = name.startswith(("demand", "force", "yaw_rate", "grip_steering", "grip_wheels"))
        if asked and not of_the_best:
            assert after[name] == pytest.approx(before[name], rel=1e-9), name


@pytest.mark.parametrize("noise", [None, IDEAL_NOISE])
def test_the_mirror_changes_nothing(motion, noise):
    more = {} if noise is None else {"noise": noise}
    banked = replace(motion, bank_rad=0.02 * np.sin(np.arange(len(motion.inside)) / 30.0))
    here, there = told_of(banked, **more), told_of(mirrored_motion(banked), **more)
    assert list(there.values()) == pytest.approx(list(here.values()), rel=1e-9, abs=1e-12)


def test_distances_grow_with_the_fall_and_the_profile_has_its_top_at_the_best(motion):
    told = told_of(motion)
    for side in ("below", "above"):
        distances = [told[f"grip_all_{side}_{deviations}sd_ratio"] for deviations in (1, 2, 4)]
        assert distances == sorted(distances)
        assert distances[0] > 0.0
    profile = np.array([told[f"grip_profile_{100 * friction_mu:.0f}_ratio"] for friction_mu in PROFILE_FRICTIONS_MU])
    assert profile.max() <= 0.0
    assert profile.min() >= PROFILE_FLOOR
    nearest = int(np.argmin(np.abs(np.log(np.array(PROFILE_FRICTIONS_MU) / told["grip_all_best_mu"]))))
    assert profile[nearest] == profile.max()


def test_between_two_frictions_that_are_asked_about_the_best_is_told_exactly():
    # Frictions a third of a percent apart are told apart, though asked about at one and a half.
    roads = tuple(0.4 * 1.0033**step for step in range(8))
    cars = driven(roads, np.column_stack([winding(0.4, 0.85)] * len(roads)))
    best = np.log([told_of(car)["grip_all_best_mu"] for car in cars])
    assert np.diff(best) == pytest.approx(np.full(len(roads) - 1, np.log(1.0033)), abs=0.002)


def test_one_axle_that_asks_for_more_than_there_is_excludes_that_friction(motion):
    told = told_of(motion)
    for friction_mu in PROFILE_FRICTIONS_MU:
        if friction_mu < 0.8 * told["demand_q100_mu"]:
            assert told[f"grip_profile_{100 * friction_mu:.0f}_ratio"] == PROFILE_FLOOR
