"""A car that is taught the same over and over comes to know it, forgets slowly, and believes no single passage."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.errors import ConfigurationError
from vehicle_client.estimation.grip.memory import (
    AUTOMOTIVE_STDS,
    CONSTANTS,
    COUNT,
    FACTOR_RANGE,
    IDEAL_STDS,
    PLACES,
    SURPRISE_LIMIT,
    CarMemory,
    Lesson,
    handling_with,
    memory_of_json,
    memory_to_json,
    new_memory,
    noise_with,
    remembered,
    scaled_handling,
)
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, IDEAL_NOISE
from vehicle_client.estimation.handling import XC90_HANDLING

NEW = new_memory(handling_std_ratio=0.1)
FIRST = np.array(NEW.first_std)
NOTHING = Lesson(np.zeros((COUNT, COUNT)), np.zeros(COUNT))


def lesson_about(truth, memory: CarMemory, *, std=0.3, seed=0) -> Lesson:
    """Return what a passage says that sees a few mixtures of the constants, as far as they differ from the memory."""
    rng = np.random.default_rng(seed)
    slopes = rng.normal(size=(5, COUNT)) / FIRST
    information = slopes.T @ slopes / std**2
    return Lesson(information, information @ (truth - np.array(memory.mean)))


def taught(truth, passages_count, memory=NEW):
    for seed in range(passages_count):
        memory = remembered(memory, lesson_about(truth, memory, seed=seed))
    return memory


@given(seed=st.integers(0, 2**32 - 1))
def test_what_many_passages_say_is_learned(seed):
    truth = np.clip(np.random.default_rng(seed).normal(size=COUNT), -2.0, 2.0) * FIRST
    memory = taught(truth, 20)
    assert np.abs((np.array(memory.mean) - truth) / FIRST).max() < 0.3
    assert memory.passages_count == 20


def test_the_more_was_seen_the_better_it_is_known():
    stds = [[taught(np.zeros(COUNT), count).std(c.name) for c in CONSTANTS] for count in (0, 1, 3, 10)]
    assert (np.diff(stds, axis=0) < 0.0).all()


def test_a_passage_that_says_nothing_leaves_the_mean_and_lets_a_little_be_forgotten():
    before = taught(FIRST, 10)
    after = remembered(before, NOTHING)
    assert after.mean == pytest.approx(before.mean)
    assert all(after.std(c.name) > before.std(c.name) for c in CONSTANTS)
    assert after.passages_count == 11


def test_nothing_is_forgotten_beyond_what_was_declared():
    memory = taught(FIRST, 3)
    for _ in range(3000):
        memory = remembered(memory, NOTHING)
    for constant, first in zip(CONSTANTS, memory.first_std, strict=True):
        assert memory.std(constant.name) <= first * (1.0 + 1e-9)


@given(size=st.floats(1.0, 1e6), seed=st.integers(0, 2**32 - 1))
def test_one_passage_moves_a_memory_no_farther_than_the_limit(size, seed):
    memory = taught(FIRST, 5)
    absurd = np.random.default_rng(seed).normal(size=COUNT) * FIRST * size
    after = remembered(memory, lesson_about(absurd, memory, std=0.01, seed=seed))
    step = np.array(after.mean) - np.array(memory.mean)
    # Measured with what the passage found, which is what a passage leaves that says nothing.
    faded = np.array(remembered(memory, NOTHING).covariance)
    assert step @ np.linalg.solve(faded, step) < SURPRISE_LIMIT * (1.0 + 1e-6)
    assert np.isfinite(after.mean).all()


def test_a_bad_passage_is_unlearned():
    good = taught(FIRST, 20)
    bad = remembered(good, lesson_about(20.0 * FIRST, good, std=0.05, seed=99))
    assert np.abs(np.array(bad.mean) / FIRST - 1.0).max() < 1.5
    again = taught(FIRST, 20, memory=bad)
    assert np.abs(np.array(again.mean) / FIRST - 1.0).max() < 0.3


# Files ---------------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), passages_count=st.integers(0, 4))
def test_a_memory_outlives_its_text(seed, passages_count):
    memory = taught(np.random.default_rng(seed).normal(size=COUNT) * FIRST, passages_count)
    assert memory_of_json(memory_to_json(memory)) == memory


def changed(**values):
    return json.dumps({**json.loads(memory_to_json(NEW)), **values})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no memory"),
        ("[]", "no memory"),
        ("{}", "no memory"),
        (changed(format=2), "other constants"),
        (changed(constants=["mass_kg"]), "other constants"),
        (changed(mean=[0.0]), "missing"),
        (changed(passages_count=-1), "missing"),
        (changed(first_std=[0.0] * COUNT), "missing"),
        (changed(covariance=np.zeros((COUNT, COUNT)).tolist()), "covariance"),
        (changed(mean=[float("nan")] * COUNT), "covariance"),
        (changed(covariance="much"), "no memory"),
    ],
)
def test_what_is_no_memory_is_refused(text, message):
    with pytest.raises(ConfigurationError, match=message):
        memory_of_json(text)


# What a memory changes -----------------------------------------------------------------------------------------------


def test_a_new_memory_changes_no_constant():
    assert handling_with(XC90_HANDLING, NEW) == XC90_HANDLING


@pytest.mark.parametrize("constant", [c for c in CONSTANTS if c.handling], ids=lambda c: c.name)
def test_each_factor_multiplies_what_it_names(constant):
    mean = [0.0] * COUNT
    mean[PLACES[constant.name]] = np.log(1.1)
    known = handling_with(XC90_HANDLING, replace(NEW, mean=tuple(mean)))
    for name in constant.handling:
        *of, last = name.split(".")
        before, after = (record.tyre if of else record for record in (XC90_HANDLING, known))
        assert getattr(after, last) == pytest.approx(1.1 * getattr(before, last))
    assert scaled_handling(known, constant, -np.log(1.1)) != known
    least = scaled_handling(XC90_HANDLING, constant, -50.0)
    assert least == scaled_handling(XC90_HANDLING, constant, np.log(FACTOR_RANGE[0]))


def test_shares_stay_shares():
    front_driven = replace(XC90_HANDLING, front_drive_frac=1.0)
    constant = CONSTANTS[PLACES["front_drive_log_ratio"]]
    assert scaled_handling(front_driven, constant, 0.3) == front_driven


@pytest.mark.parametrize(
    ("noise", "stds"), [(AUTOMOTIVE_NOISE, AUTOMOTIVE_STDS), (IDEAL_NOISE, IDEAL_STDS)], ids=["automotive", "ideal"]
)
def test_a_memory_never_makes_sensors_less_trusted_and_in_time_more(noise, stds):
    new = new_memory(handling_std_ratio=0.01, sensor_stds=stds)
    old = replace(new, covariance=tuple(tuple(0.01 * value for value in row) for row in new.covariance))
    tightened = ("steer_offset_rad", "yaw_rate_scale_ratio", "force_y_offset_mps2", "radius_ratio", "level_gain_ratio")
    for memory in (new, old):
        known = noise_with(noise, memory, approach_steer_std_rad=0.001)
        assert all(getattr(known, name) <= getattr(noise, name) for name in (*tightened, "force_x_offset_mps2"))
    if noise is AUTOMOTIVE_NOISE:
        assert all(getattr(known, name) < 0.6 * getattr(noise, name) for name in tightened)


def test_rough_constants_are_known_to_be_rough():
    assert noise_with(AUTOMOTIVE_NOISE, NEW, approach_steer_std_rad=0.001).stiffness_ratio > 0.1
