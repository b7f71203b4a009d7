from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain.shrinkage import Shrinkage, unshrunk

FAITHFUL = Shrinkage((0.05, 0.2), (0.4, 0.4), (0.4, 0.4), (1.0, 1.0), (0.05, 0.2))
SHY = Shrinkage((0.02, 0.1, 0.3), (0.3, 0.4, 0.45), (0.3, 0.41, 0.42), (0.98, 0.8, 0.4), (0.03, 0.1, 0.18))
MU = np.array([0.2, 0.35, 0.6])


def test_what_is_not_drawn_stays_where_it_is():
    got = unshrunk(MU, expected_error_ratio=np.array([0.05, 0.1, 0.2]), shrinkage=FAITHFUL)
    assert got.mu == pytest.approx(MU)
    assert got.noise_ratio == pytest.approx([0.05, 0.125, 0.2])


@given(mu=st.floats(0.1, 0.9), level=st.sampled_from(range(3)))
def test_the_usual_answer_comes_back_to_the_friction_that_gives_it(mu, level):
    answer = SHY.usual_estimate_mu[level] * (mu / SHY.usual_mu[level]) ** SHY.slope_ratio[level]
    expected = np.array([SHY.expected_error_ratio[level]])
    got = unshrunk(np.array([answer]), expected_error_ratio=expected, shrinkage=SHY)
    assert got.mu[0] == pytest.approx(mu)
    assert got.noise_ratio[0] == pytest.approx(SHY.noise_ratio[level] / SHY.slope_ratio[level])


@given(expected=st.floats(0.001, 2.0), first=st.floats(0.1, 0.9), second=st.floats(0.1, 0.9))
def test_the_order_stays_and_distances_grow(expected, first, second):
    errors = np.full(2, expected)
    got = unshrunk(np.array([first, second]), expected_error_ratio=errors, shrinkage=SHY)
    before, after = np.log(second / first), np.log(got.mu[1] / got.mu[0])
    assert before * after >= 0.0
    assert abs(after) >= abs(before) * (1.0 - 1e-9)


def test_beyond_the_levels_it_is_as_at_the_last_one():
    far, last = (unshrunk(MU, expected_error_ratio=np.full(3, at), shrinkage=SHY) for at in (3.0, 0.3))
    assert far.mu == pytest.approx(last.mu)
    assert far.noise_ratio == pytest.approx(last.noise_ratio)


def test_many_shy_answers_add_up_to_the_truth(rng):
    found = 0.65 * rng.uniform(0.9, 1.0, 4000)
    slope, noise = SHY.slope_ratio[2], SHY.noise_ratio[2]
    answers = SHY.usual_estimate_mu[2] * (found / SHY.usual_mu[2]) ** slope * np.exp(noise * rng.standard_normal(4000))
    got = unshrunk(answers, expected_error_ratio=np.full(4000, 0.3), shrinkage=SHY)
    assert np.exp(np.log(answers).mean()) < 0.55
    assert np.exp(np.log(got.mu).mean()) == pytest.approx(np.exp(np.log(found).mean()), rel=0.03)


@pytest.mark.parametrize(
    "changes",
    [
        {"slope_ratio": (1.0, 0.0)},
        {"noise_ratio": (0.1,)},
        {"usual_mu": (0.4, np.nan)},
        {"expected_error_ratio": (0.2, 0.05)},
    ],
)
def test_a_shrinkage_that_cannot_be_is_refused(changes):
    with pytest.raises(ValueError, match=r"shrinkage|levels"):
        replace(FAITHFUL, **changes)


def test_no_level_at_all_is_refused():
    with pytest.raises(ValueError, match="one level at least"):
        Shrinkage((), (), (), (), ())
