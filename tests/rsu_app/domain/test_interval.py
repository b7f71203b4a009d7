from __future__ import annotations

from itertools import pairwise
from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.records import Confidence
from rsu_app.domain.interval import (
    IntervalPolicy,
    confidence_of,
    friction_interval,
    median_of_ordered,
    median_ranks,
    mu_low_of_median,
    ranks_despite_liars,
)

POLICY = IntervalPolicy()
FRICTIONS = st.lists(st.floats(0.05, 1.5), min_size=1, max_size=80).map(sorted)


@pytest.mark.parametrize(("count", "low_rank"), [(6, 1), (10, 2), (20, 6), (50, 18), (100, 40)])
def test_the_ranks_are_the_ones_tables_print(count, low_rank):
    ranks = median_ranks(count, confidence_frac=0.95)
    assert (ranks.low_rank, ranks.high_rank) == (low_rank, count + 1 - low_rank)
    assert ranks.coverage_frac >= 0.95


@given(st.integers(1, 400), st.floats(0.5, 0.999))
def test_coverage_is_the_binomial_probability_and_no_wider_pair_was_needed(count, confidence_frac):
    def coverage(low_rank):
        return 1.0 - 2.0 * sum(comb(count, k) for k in range(low_rank)) / 2**count

    ranks = median_ranks(count, confidence_frac=confidence_frac)
    assert ranks.coverage_frac == pytest.approx(max(0.0, coverage(ranks.low_rank)), abs=1e-9)
    assert 1 <= ranks.low_rank <= ranks.high_rank <= count
    if 2 * (ranks.low_rank + 1) <= count + 1:
        assert coverage(ranks.low_rank + 1) < confidence_frac + 1e-9


@pytest.mark.parametrize(("count", "coverage_frac"), [(1, 0.0), (2, 0.5), (5, 0.9375)])
def test_too_few_vehicles_give_the_extremes_with_the_coverage_they_have(count, coverage_frac):
    ranks = median_ranks(count, confidence_frac=0.95)
    assert (ranks.low_rank, ranks.high_rank) == (1, count)
    assert ranks.coverage_frac == pytest.approx(coverage_frac)


def test_ranks_of_a_full_window_do_not_underflow():
    ranks = median_ranks(20_000, confidence_frac=0.95)
    # Normal approximation of the binomial: n/2 - 1.96 sqrt(n)/2.
    assert ranks.low_rank == pytest.approx(10_000 - 0.98 * np.sqrt(20_000.0), abs=2.0)
    assert 0.95 <= ranks.coverage_frac < 0.952


def test_the_stated_coverage_is_what_a_skewed_population_gives(rng):
    samples = np.sort(rng.exponential(1.0, (20_000, 20)), axis=1)
    ranks = median_ranks(20, confidence_frac=0.95)
    covered = (samples[:, ranks.low_rank - 1] <= np.log(2.0)) & (np.log(2.0) <= samples[:, ranks.high_rank - 1])
    assert covered.mean() == pytest.approx(ranks.coverage_frac, abs=0.006)


def test_no_values_have_no_ranks():
    with pytest.raises(ValueError, match="no values"):
        median_ranks(0, confidence_frac=0.95)


@given(FRICTIONS)
def test_the_interval_lies_about_its_median(ordered_mu):
    interval = friction_interval(ordered_mu, newest_age_s=0.0, policy=POLICY)
    assert interval is not None
    assert interval.median_mu == pytest.approx(float(np.median(ordered_mu)))
    assert interval.mu_new == pytest.approx(interval.median_mu / 0.9)
    assert interval.mu_low == pytest.approx(0.8 * interval.mu_new)
    assert (interval.mu_low + interval.mu_new) / 2.0 == pytest.approx(interval.median_mu)
    assert interval.median_low_mu <= interval.median_mu <= interval.median_high_mu
    assert interval.passages_count == len(ordered_mu)


@given(FRICTIONS, st.floats(0.5, 2.0))
def test_scaling_every_estimate_scales_the_interval(ordered_mu, factor):
    plain = friction_interval(ordered_mu, newest_age_s=0.0, policy=POLICY)
    scaled = friction_interval([factor * mu for mu in ordered_mu], newest_age_s=0.0, policy=POLICY)
    assert plain is not None
    assert scaled is not None
    assert scaled.mu_new == pytest.approx(factor * plain.mu_new)
    assert scaled.median_low_mu == pytest.approx(factor * plain.median_low_mu)


def test_without_vehicles_there_is_no_interval():
    assert friction_interval([], newest_age_s=0.0, policy=POLICY) is None


@pytest.mark.parametrize(
    ("count", "confidence"),
    [
        (1, Confidence.INSUFFICIENT),
        (9, Confidence.INSUFFICIENT),
        (10, Confidence.PROVISIONAL),
        (49, Confidence.PROVISIONAL),
        (50, Confidence.RECOMMENDED),
    ],
)
def test_confidence_is_a_matter_of_count(count, confidence):
    assert confidence_of(count, policy=POLICY) is confidence


def test_an_interval_is_valid_until_its_newest_vehicle_is_stale():
    policy = IntervalPolicy(stale_after_s=1000.0, valid_at_most_s=300.0)
    valid_for_s = []
    for newest_age_s in (0.0, 699.0, 800.0, 1000.0, 5000.0):
        interval = friction_interval([0.5], newest_age_s=newest_age_s, policy=policy)
        assert interval is not None
        valid_for_s.append(interval.valid_for_s)
    assert valid_for_s == [300.0, 300.0, 200.0, 0.0, 0.0]


def test_the_median_of_an_even_count_is_the_middle_of_two():
    assert median_of_ordered([0.2, 0.4, 0.6, 0.9]) == 0.5


def test_the_lower_end_grows_with_the_median():
    assert all(a < b for a, b in pairwise(mu_low_of_median(mu) for mu in (0.1, 0.2, 0.9)))


@pytest.mark.parametrize(
    "decisions",
    [
        {"provisional_from_count": 60},
        {"provisional_from_count": 0},
        {"confidence_frac": 1.0},
        {"stale_after_s": 0.0},
        {"valid_at_most_s": -1.0},
    ],
)
def test_a_policy_that_contradicts_itself_is_refused(decisions):
    with pytest.raises(ValueError, match=r".+"):
        IntervalPolicy(**decisions)


@given(st.integers(1, 200), st.integers(0, 60), st.floats(0.5, 0.99))
def test_ranks_despite_liars_enclose_those_of_the_honest_alone(honest_count, liars_count, confidence_frac):
    alone = median_ranks(honest_count, confidence_frac=confidence_frac)
    count = honest_count + liars_count
    ranks = ranks_despite_liars(count, liars_count=liars_count, confidence_frac=confidence_frac)
    honest = np.linspace(0.3, 0.5, honest_count)
    for lie_mu in (0.0, 0.4, 1.0):
        all_of_them = np.sort(np.append(honest, np.full(liars_count, lie_mu)))
        assert all_of_them[ranks.low_rank - 1] <= honest[alone.low_rank - 1]
        assert all_of_them[ranks.high_rank - 1] >= honest[alone.high_rank - 1]
    assert ranks.coverage_frac == alone.coverage_frac


def test_among_liars_alone_there_is_nobody_to_believe():
    with pytest.raises(ValueError, match="nobody"):
        ranks_despite_liars(3, liars_count=3, confidence_frac=0.95)
