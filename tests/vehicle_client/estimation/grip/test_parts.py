"""A road that does not have one friction all along: where the drive is cut, and what each part found."""

import numpy as np
import pytest

from tests.vehicle_client.estimation.grip.two_axles import driven, mirrored_motion, told_of, winding
from vehicle_client.estimation.grip.parts import PART_MIN_S, cut_in_two

STEP_S = 0.1
COUNT = 80
FRICTIONS_MU = np.linspace(0.2, 0.8, 61)
WEIGHT = np.full(COUNT, 0.5)


def told_by_sample(*best_mu, noise=0.0):
    """Return how well frictions explain samples, equally many of which like each of the given frictions best."""
    sensed = np.repeat(best_mu, COUNT // len(best_mu)) + noise * np.random.default_rng(1).normal(size=COUNT)
    return -0.5 * WEIGHT * ((FRICTIONS_MU[:, None] - sensed) / 0.05) ** 2


def cut(told, weight=WEIGHT):
    parts = cut_in_two(told, weight, step_s=STEP_S)
    assert parts is not None
    return parts


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_the_cut_is_where_the_friction_changes(noise):
    first, second = cut(told_by_sample(0.6, 0.3, noise=noise))
    assert np.flatnonzero(first)[-1] == COUNT // 2 - 1
    assert first + second == pytest.approx(WEIGHT)


def test_samples_that_do_not_count_are_in_neither_part():
    weight = np.where(np.arange(COUNT) % 10 == 9, 0.0, WEIGHT)
    told = told_by_sample(0.6, 0.3) * (weight > 0.0)
    first, second = cut(told, weight)
    assert first + second == pytest.approx(weight)
    assert (first * second == 0.0).all()


def test_no_part_is_shorter_than_what_says_something_of_its_own():
    told = told_by_sample(0.3)
    told[:, :6] = told_by_sample(0.8)[:, :6]
    first, _ = cut(told)
    assert np.count_nonzero(first) == pytest.approx(PART_MIN_S / STEP_S)


def test_a_drive_too_short_for_two_parts_is_not_cut():
    count = round(2 * PART_MIN_S / STEP_S) - 1
    assert cut_in_two(told_by_sample(0.6, 0.3)[:, :count], WEIGHT[:count], step_s=STEP_S) is None


def test_a_drive_that_likes_one_friction_is_not_cut():
    assert cut_in_two(told_by_sample(0.5, noise=0.03), WEIGHT, step_s=STEP_S) is None


def two_frictions(before_mu, after_mu, *, use_ratio=0.85):
    """Return a drive whose friction changes half way, where nothing is asked of the road."""
    least_mu = min(before_mu, after_mu)
    return driven((before_mu,), winding(least_mu, use_ratio, duration_s=24.0)[:, None], later_mu=(after_mu,))[0]


@pytest.mark.parametrize(("before_mu", "after_mu"), [(0.6, 0.3), (0.3, 0.6), (0.45, 0.25), (0.9, 0.5)])
def test_the_friction_of_the_slippery_part_is_found_whichever_comes_first(before_mu, after_mu):
    told = told_of(two_frictions(before_mu, after_mu))
    weak_mu = told["grip_all_best_mu"] * np.exp(told["grip_weak_shift_ratio"])
    assert weak_mu == pytest.approx(min(before_mu, after_mu), rel=0.02)
    assert told["grip_parts_gain_ratio"] > 5.0
    assert told["grip_firm_shift_ratio"] > told["grip_weak_shift_ratio"]
    assert told["demand_weak_use_ratio"] == pytest.approx(0.85, abs=0.06)


def test_the_slippery_part_is_known_better_than_all_of_the_drive_says():
    told = told_of(two_frictions(0.6, 0.3))
    assert told["grip_all_best_mu"] > 1.02 * 0.3


def test_one_friction_all_along_is_not_taken_for_two():
    told = told_of(driven((0.5,), winding(0.5, 0.85, duration_s=24.0)[:, None])[0])
    assert told["grip_parts_gain_ratio"] == 0.0
    assert told["grip_weak_shift_ratio"] == told["grip_firm_shift_ratio"] == 0.0
    for distance in ("below_1sd", "above_1sd", "above_2sd"):
        assert told[f"grip_weak_{distance}_ratio"] == told[f"grip_all_{distance}_ratio"]
    assert told["demand_weak_use_ratio"] == told["demand_q100_use_ratio"]


def test_the_mirror_changes_nothing_about_the_parts():
    drive = two_frictions(0.6, 0.3)
    there = told_of(mirrored_motion(drive))
    assert list(there.values()) == pytest.approx(list(told_of(drive).values()), rel=1e-9, abs=1e-12)
