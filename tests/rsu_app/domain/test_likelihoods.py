"""The memory of likelihoods says what all of them together place, as long as they count."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.features import PROFILE_FRICTIONS_MU
from rsu_app.domain.likelihoods import LikelihoodWindow
from rsu_app.domain.profiles import ProfilePolicy, pooled_profile

GRID_MU = np.array(PROFILE_FRICTIONS_MU)


def profile_of(mu, *, width_ratio=0.1):
    return np.maximum(-0.5 * (np.log(GRID_MU / mu) / width_ratio) ** 2, -40.0)


def filled(told, **options):
    window = LikelihoodWindow(window_s=3600.0, **options)
    for at_s, mu in told:
        window.add(left_at_s=at_s, profile_ratio=profile_of(mu))
    return window


def test_without_passages_nothing_is_placed():
    assert LikelihoodWindow(window_s=60.0).placed(now_s=0.0) is None
    assert filled([(0.0, 0.4)]).placed(now_s=4000.0) is None


TOLD = st.lists(st.tuples(st.floats(0.0, 3000.0), st.floats(0.15, 0.8)), min_size=1, max_size=20)


@given(TOLD, st.randoms(use_true_random=False))
def test_it_is_what_pooling_all_of_them_gives_whatever_their_order(told, chance):
    shuffled = chance.sample(told, len(told))
    pooled = pooled_profile(np.array([profile_of(mu) for _, mu in told]), grid_mu=GRID_MU, policy=ProfilePolicy())
    placed = filled(shuffled).placed(now_s=3000.0)
    assert placed is not None
    assert pooled is not None
    assert placed.mu_new == pytest.approx(pooled.mu_new)
    assert (placed.at_least, placed.informative_count) == (pooled.at_least, pooled.informative_count)


def test_what_is_too_old_is_forgotten_and_what_was_before_a_change_does_not_count():
    told = [(float(i), 0.6) for i in range(30)] + [(1000.0 + i, 0.2) for i in range(30)]
    window = filled(told)
    assert window.placed(now_s=1100.0, counted_from_s=1000.0).mu_new == pytest.approx(0.22, rel=0.05)
    assert window.placed(now_s=4000.0).mu_new == pytest.approx(0.22, rel=0.05)
    assert len(window) == 30


def test_the_newest_are_kept_and_no_more_than_there_is_room_for():
    window = filled([(float(i), 0.6) for i in (3, 1, 2, 0)], capacity_count=2)
    assert len(window) == 2
    assert window.placed(now_s=3.0, counted_from_s=2.0) == window.placed(now_s=3.0)
