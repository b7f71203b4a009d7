"""Many stretches of a recursion at once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.estimation.recursion import BLOCK_STEPS_COUNT, recursion_states

seeds = st.integers(0, 2**32 - 1)


def forgetting(seed, count):
    """Return coefficients of a recursion whose memory fades, and their addends."""
    rng = np.random.default_rng(seed)
    transition = (
        rng.uniform(0.7, 0.95, count),
        rng.normal(0.0, 0.01, count),
        rng.normal(0.0, 0.05, count),
        rng.uniform(0.98, 1.0, count),
    )
    return transition, (rng.normal(0.0, 3.0, count), rng.normal(0.0, 0.1, count))


def step_by_step(transition, addend, start):
    x, y = start
    states = [(x, y)]
    for m00, m01, m10, m11, c0, c1 in zip(*transition, *addend, strict=True):
        x, y = m00 * x + m01 * y + c0, m10 * x + m11 * y + c1
        states.append((x, y))
    return np.array(states).T


@given(seed=seeds, count=st.integers(0, 5 * BLOCK_STEPS_COUNT), start=st.tuples(st.floats(-50, 50), st.floats(-5, 5)))
def test_the_states_are_those_of_one_step_after_the_other(seed, count, start):
    transition, addend = forgetting(seed, count)
    expected = step_by_step(transition, addend, start)
    assert np.allclose(recursion_states(transition, addend, start=start), expected, rtol=1e-11, atol=1e-11)


def test_ten_minutes_are_as_exact_as_one_second():
    transition, addend = forgetting(4, 60_000)
    expected = step_by_step(transition, addend, (30.0, 0.0))
    assert np.allclose(recursion_states(transition, addend, start=(30.0, 0.0)), expected, rtol=1e-11, atol=1e-11)


def test_what_neither_fades_nor_grows_stays_bounded():
    angle = np.full(60_000, 0.01)
    turning = (np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle))
    x, y = recursion_states(turning, (np.zeros(60_000), np.zeros(60_000)), start=(1.0, 0.0))
    assert np.allclose(np.hypot(x, y), 1.0, atol=1e-9)
    assert x[-1] == pytest.approx(np.cos(600.0), abs=1e-9)


@given(seed=seeds, at=st.integers(0, 3 * BLOCK_STEPS_COUNT - 1), which=st.integers(0, 5))
def test_a_nan_spreads_to_all_later_states_and_to_none_before(seed, at, which):
    transition, addend = forgetting(seed, 3 * BLOCK_STEPS_COUNT)
    (*transition, *addend)[which][at] = np.nan
    with np.errstate(invalid="ignore"):
        states = np.array(recursion_states(transition, addend, start=(10.0, 0.0)))
    assert np.isfinite(states[:, : at + 1]).all()
    assert np.isnan(states[:, at + 2 :]).all()


@given(seed=seeds)
def test_a_mirror_image_mirrors_the_second_state_to_the_last_bit(seed):
    (m00, m01, m10, m11), (c0, c1) = forgetting(seed, 70)
    x, y = recursion_states((m00, m01, m10, m11), (c0, c1), start=(10.0, 1.0))
    mirrored_x, mirrored_y = recursion_states((m00, -m01, -m10, m11), (c0, -c1), start=(10.0, -1.0))
    assert np.array_equal(mirrored_x, x)
    assert np.array_equal(mirrored_y, -y)
