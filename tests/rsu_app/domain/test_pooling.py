from __future__ import annotations

from dataclasses import asdict, replace
from math import inf, isinf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain.interval import median_ranks
from rsu_app.domain.pooling import (
    PoolingPolicy,
    bounds_despite_liars,
    kaplan_meier_median_mu,
    placing_median_mu,
    posterior_placement,
    refined_interval,
    refined_interval_of_window,
    support,
)
from rsu_app.domain.wear import estimate_density
from rsu_app.domain.window import FrictionWindow

POLICY = PoolingPolicy()
UNCLIPPED = replace(POLICY, clip_frac=9.0)
ENTRY = st.tuples(st.floats(0.1, 1.2), st.one_of(st.just(nan), st.floats(0.0, 0.4)), st.booleans())
ENTRIES = st.lists(ENTRY, min_size=1, max_size=40)


def columns(entries):
    mu, error, at_least = zip(*entries, strict=True)
    return np.array(mu), np.array(error), np.array(at_least, dtype=bool)


def refined(entries, policy=POLICY):
    mu, error, at_least = columns(entries)
    return refined_interval(mu, expected_error_ratio=error, at_least=at_least, policy=policy)


def placed_by_all(mu, expected_error_ratio, policy=POLICY):
    return refined_interval(
        mu, expected_error_ratio=expected_error_ratio, at_least=np.zeros(len(mu), dtype=bool), policy=policy
    )


def exact(*mu, error=nan):
    return [(one, error, False) for one in mu]


def drawn(rng, count, *, mu_new=0.5, noise=(0.02, 0.08), outlier_frac=0.03):
    noise_ratio = rng.uniform(*noise, count)
    mu = mu_new * rng.uniform(0.8, 1.0, count) * np.exp(noise_ratio * rng.standard_normal(count))
    strange = rng.random(count) < outlier_frac
    mu[strange] = rng.uniform(0.05, 1.2, np.count_nonzero(strange))
    return mu, noise_ratio / np.sqrt(np.pi / 2.0)


# The median with bounds ----------------------------------------------------------------------------------------------


@given(st.lists(st.floats(0.05, 1.5), min_size=1, max_size=60))
def test_without_bounds_it_is_the_median(mu):
    assert kaplan_meier_median_mu(np.array(mu), np.zeros(len(mu), dtype=bool)) == pytest.approx(np.median(mu))


def test_the_median_of_a_textbook_sample():
    # Weeks in remission with 6-mercaptopurine (Freireich et al., Blood 21, 1963): the median is 23 weeks.
    weeks = [6, 6, 6, 7, 10, 13, 16, 22, 23, 6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35]
    censored = [False] * 9 + [True] * 12
    assert kaplan_meier_median_mu(np.array(weeks, dtype=float), np.array(censored)) == 23.0


@given(ENTRIES, st.floats(0.05, 1.5))
def test_a_further_bound_never_lowers_the_median(entries, bound_mu):
    before, after = columns(entries), columns([*entries, (bound_mu, nan, True)])
    old, new = kaplan_meier_median_mu(before[0], before[2]), kaplan_meier_median_mu(after[0], after[2])
    assert new is None or (old is not None and new >= old - 1e-12)


def test_bounds_below_every_estimate_change_nothing():
    mu = np.array([0.1, 0.12, 0.15, 0.4, 0.5, 0.6])
    at_least = np.array([True, True, True, False, False, False])
    assert kaplan_meier_median_mu(mu, at_least) == 0.5


def test_cut_off_friction_is_where_the_plain_median_fails(rng):
    # Half of the cars never need more than 0.45 and then only know that there is that much.
    truth = 0.6 * rng.uniform(0.8, 1.0, 4000)
    needed = np.where(rng.random(4000) < 0.5, 0.45, inf)
    at_least = needed < truth
    said = np.minimum(truth, needed)
    assert np.median(said) == pytest.approx(0.48, abs=0.03)
    assert placing_median_mu(said, at_least)[0] == pytest.approx(0.54, abs=0.01)


# The refined interval ------------------------------------------------------------------------------------------------


def test_nobody_places_nothing():
    assert (
        refined_interval(np.zeros(0), expected_error_ratio=np.zeros(0), at_least=np.zeros(0, bool), policy=POLICY)
        is None
    )


@given(st.floats(0.05, 1.5))
def test_one_vehicle_places_what_the_median_would_nearly(mu):
    one = refined(exact(mu))
    assert one.mu_new == pytest.approx(mu / 0.9, rel=0.02)
    assert one.mu_low == pytest.approx(0.8 * one.mu_new)
    assert mu / 0.9 - one.half_width_mu < mu / 0.8 < one.mu_new + one.half_width_mu
    assert (one.informative_count, one.censored_count) == (1, 0)


@given(ENTRIES, st.randoms(use_true_random=False))
def test_the_order_of_vehicles_does_not_matter(entries, chance):
    shuffled = list(entries)
    chance.shuffle(shuffled)
    assert asdict(refined(shuffled)) == pytest.approx(asdict(refined(entries)), rel=1e-9)


@given(ENTRIES, st.floats(0.5, 2.0))
def test_scaling_every_estimate_scales_the_interval(entries, factor):
    plain, scaled = refined(entries), refined([(factor * mu, *rest) for mu, *rest in entries])
    assert scaled.mu_new == pytest.approx(factor * plain.mu_new, rel=1e-6)
    assert scaled.half_width_mu == pytest.approx(factor * plain.half_width_mu, rel=1e-6)
    assert scaled.at_least == plain.at_least


@given(ENTRIES)
def test_the_median_holds_the_result(entries):
    mu, _, at_least = columns(entries)
    placed = refined(entries)
    if placed.at_least:
        assert placed.mu_new * 0.9 >= np.median(mu) * (1.0 - 1e-9)
    else:
        assert abs(placed.mu_new * 0.9 / placing_median_mu(mu, at_least)[0] - 1.0) <= POLICY.clip_frac + 1e-9


@given(ENTRIES, st.floats(0.1, 1.2), st.floats(0.0, 0.4))
def test_a_further_bound_never_lowers_where_the_posterior_places_the_interval(entries, bound_mu, error):
    mu, errors, at_least = columns(entries)
    median_mu = float(np.median(mu))

    def place(mu, errors, at_least):
        return posterior_placement(
            mu, expected_error_ratio=errors, at_least=at_least, median_mu=median_mu, policy=POLICY
        ).mu_new

    before = place(mu, errors, at_least)
    assert place(np.append(mu, bound_mu), np.append(errors, error), np.append(at_least, True)) >= before * (1 - 1e-9)


@given(st.lists(st.floats(0.1, 1.2), min_size=1, max_size=20))
def test_only_bounds_place_a_bound(mu):
    only = refined([(one, nan, True) for one in mu])
    assert only.at_least
    assert isinf(only.half_width_mu)
    assert only.mu_new == pytest.approx(np.median(mu) / 0.9)
    assert (only.informative_count, only.censored_count) == (0, len(mu))


def test_a_few_who_name_a_friction_among_many_who_do_not_place_a_bound():
    few = refined([*exact(0.8, 0.82), *[(0.3, nan, True)] * 5])
    assert few.at_least
    assert few.mu_new == pytest.approx(0.3 / 0.9)


@given(
    named=st.lists(st.floats(0.1, 1.2), min_size=6, max_size=40),
    bounds=st.lists(st.floats(0.01, 1.2), max_size=200),
    further=st.lists(st.floats(0.01, 1.2), max_size=200),
)
def test_no_number_of_vehicles_that_know_nothing_lowers_what_those_who_know_are_sure_of(named, bounds, further):
    sure_mu = sorted(named)[median_ranks(len(named), confidence_frac=0.95).low_rank - 1]
    for some in (bounds, bounds + further):
        placed = refined([*exact(*named), *[(mu, 0.0, True) for mu in some]])
        assert placed.mu_new >= sure_mu / 0.9 * (1.0 - POLICY.clip_frac) - 1e-9


@given(ENTRIES)
def test_support_counts_and_marks_as_the_refined_interval_does(entries):
    mu, _, at_least = columns(entries)
    known, placed = support(mu, at_least, policy=POLICY), refined(entries)
    assert known is not None
    assert (known.named_count, known.censored_count) == (placed.informative_count, placed.censored_count)
    assert known.at_least == placed.at_least
    assert known.least_mu_low == pytest.approx(0.8 / 0.9 * np.median(mu))
    if known.at_least:
        assert known.bound_mu == pytest.approx(0.9 * placed.mu_new)
    if known.named_count:
        assert known.named_mu_low == pytest.approx(0.8 / 0.9 * np.median(mu[~at_least]))


def test_nobody_supports_nothing():
    assert support(np.zeros(0), np.zeros(0, dtype=bool), policy=POLICY) is None


def test_low_bounds_say_little():
    without, with_bounds = refined(exact(0.4, 0.45, 0.43)), refined([*exact(0.4, 0.45, 0.43), *[(0.1, 0.0, True)] * 3])
    assert with_bounds.mu_new == pytest.approx(without.mu_new, rel=1e-3)
    assert not with_bounds.at_least


def test_the_surer_vehicle_decides():
    unsure_high = refined([(0.45, 0.02, False), (0.5, 0.2, False)], UNCLIPPED)
    unsure_low = refined([(0.45, 0.2, False), (0.5, 0.02, False)], UNCLIPPED)
    assert unsure_high.mu_new < unsure_low.mu_new - 0.02


def test_one_absurd_value_hardly_moves_the_rest():
    honest = exact(0.42, 0.44, 0.45, 0.46, 0.47, 0.48, error=0.03)
    plain, absurd = refined(honest, UNCLIPPED), refined([*honest, (1.5, 0.03, False)], UNCLIPPED)
    assert absurd.mu_new == pytest.approx(plain.mu_new, rel=0.02)


@pytest.mark.parametrize(("count", "median_percent", "refined_percent"), [(10, 2.8, 2.15), (50, 1.35, 0.9)])
def test_honest_vehicles_are_used_better_than_by_the_median(rng, count, median_percent, refined_percent):
    errors = []
    for _ in range(400):
        mu, expected = drawn(rng, count)
        placed = placed_by_all(mu, expected)
        errors.append((np.median(mu) / 0.45 - 1.0, placed.mu_new / 0.5 - 1.0))
    by_median, by_refined = 100.0 * np.abs(errors).mean(axis=0)
    assert by_median == pytest.approx(median_percent, rel=0.15)
    assert by_refined == pytest.approx(refined_percent, rel=0.15)


def test_the_half_width_covers_the_truth_with_an_error_that_all_share(rng):
    covered = []
    for _ in range(400):
        mu, expected = drawn(rng, 50)
        bias = np.exp(0.03 * rng.standard_normal())
        placed = placed_by_all(bias * mu, expected)
        covered.append(abs(placed.mu_new - 0.5) <= placed.half_width_mu)
    assert np.mean(covered) > 0.93


@pytest.mark.parametrize("expected_ratio", [0.01, 0.04, 0.2])
def test_the_half_width_grows_with_the_errors_expected_however_many_vehicles(rng, expected_ratio):
    mu = 0.5 * rng.uniform(0.8, 1.0, 20_000)
    placed = placed_by_all(mu, np.full(20_000, expected_ratio), replace(UNCLIPPED, shared_error_frac=0.5))
    assert placed.half_width_mu == pytest.approx(1.96 * max(0.03, 0.5 * expected_ratio) * placed.mu_new, rel=0.05)


@pytest.mark.parametrize("lie_mu", [0.05, 0.4, 0.55, 1.2])
def test_a_share_of_liars_is_inside_the_half_width_if_it_is_assumed(rng, lie_mu):
    policy = replace(POLICY, liars_frac=0.3)
    for _ in range(20):
        mu, expected = drawn(rng, 50)
        mu[:15] = lie_mu
        placed = placed_by_all(mu, expected, policy)
        assert abs(placed.mu_new - 0.5) <= placed.half_width_mu


def test_more_bounds_than_ranks_leave_the_upper_end_open():
    mu, at_least = np.linspace(0.3, 0.5, 20), np.arange(20) >= 12
    low_mu, high_mu = bounds_despite_liars(mu, at_least, policy=replace(POLICY, liars_frac=0.3))
    assert 0.3 <= low_mu < 0.4
    assert isinf(high_mu)
    assert bounds_despite_liars(mu[:1], at_least[:1], policy=replace(POLICY, liars_frac=0.3)) == (0.0, inf)


def test_twenty_thousand_are_no_worse_than_twenty(rng):
    mu, expected = drawn(rng, 20_000)
    placed = placed_by_all(mu, expected)
    assert placed.mu_new == pytest.approx(0.5, rel=0.003)
    # Nothing is left but the error that all share.
    assert placed.half_width_mu == pytest.approx(1.96 * 0.03 * placed.mu_new, rel=0.02)


@given(st.floats(0.32, 0.8), st.floats(0.02, 0.4))
def test_bins_and_levels_lose_nothing(mu, noise_ratio):
    # Two estimates alike, and one beside them that lies between bins, with a noise between levels.
    noise = np.array([0.05, 0.05, noise_ratio])
    said = np.array([0.5, 0.5, mu])
    placed = refined(
        list(zip(said.tolist(), (noise / np.sqrt(np.pi / 2.0)).tolist(), [False] * 3, strict=True)), UNCLIPPED
    )
    grid_mu = np.exp(np.linspace(np.log(0.37), np.log(0.82), 4001))
    posterior = np.ones_like(grid_mu)
    for y, s in zip(said.tolist(), noise.tolist(), strict=True):
        density = estimate_density(np.log(y) - np.log(grid_mu), noise_ratio=s)
        posterior *= (1.0 - POLICY.outlier_frac) * density + POLICY.outlier_frac * 0.3
    middle_mu = np.interp(0.5, np.cumsum(posterior) / posterior.sum(), grid_mu)
    assert placed.mu_new == pytest.approx(middle_mu, rel=0.004)


def test_a_window_hands_over_its_bounds():
    window = FrictionWindow()
    for at_s, mu in enumerate((0.4, 0.42, 0.44, 0.46, 0.48)):
        window.add(left_at_s=float(at_s), mu=mu, expected_error_ratio=0.03)
    window.add(left_at_s=9.0, mu=0.2, at_least=True, mu_low=0.1, expected_error_ratio=0.5)
    placed = refined_interval_of_window(window.rows, policy=POLICY)
    assert placed is not None
    assert placed.censored_count == 1
    assert placed.mu_new == pytest.approx(0.44 / 0.9, rel=0.025)


def window_with_liars(policy):
    """35 vehicles on ice, ten of which feel it; 15 liars name dry asphalt."""
    window = FrictionWindow()
    for at_s in range(25):
        window.add(left_at_s=float(at_s), mu=0.3, at_least=True, mu_low=0.15, expected_error_ratio=0.3)
    for at_s in range(10):
        window.add(left_at_s=100.0 + at_s, mu=0.18 + 0.001 * at_s, expected_error_ratio=0.03)
    for at_s in range(15):
        window.add(left_at_s=200.0 + at_s, mu=0.7 + 0.001 * at_s, mu_low=0.68, expected_error_ratio=0.01)
    return refined_interval_of_window(window.rows, policy=policy)


def test_the_few_who_name_a_friction_do_not_lead_far_above_the_median_of_all():
    free, held = window_with_liars(replace(POLICY, lead_frac=9.0)), window_with_liars(POLICY)
    assert free is not None
    assert held is not None
    assert free.mu_new > 0.7
    assert held.mu_new == pytest.approx(1.05 * 0.3 / 0.9)
    assert held.mu_low == pytest.approx(0.8 * held.mu_new)
    assert held.clipped
    assert held.mu_new + held.half_width_mu >= free.mu_new + free.half_width_mu - 1e-9


@given(ENTRIES.filter(lambda entries: len(entries) > 2), st.floats(0.0, 0.3))
def test_no_window_leads_further_than_the_policy_says(entries, lead_frac):
    window = FrictionWindow()
    for at_s, (mu, error, at_least) in enumerate(entries):
        window.add(left_at_s=float(at_s), mu=mu, at_least=at_least, mu_low=0.8 * mu, expected_error_ratio=error)
    placed = refined_interval_of_window(window.rows, policy=replace(POLICY, lead_frac=lead_frac))
    assert placed is not None
    assert placed.mu_new <= (1.0 + lead_frac) * float(np.median(window.rows.mu)) / 0.9 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    "assumed",
    [
        {"lowest_noise_ratio": 0.0},
        {"lowest_noise_ratio": 0.5},
        {"typical_error_ratio": 0.0},
        {"named_frac": 0.0},
        {"outlier_frac": 0.0},
        {"confidence_frac": 1.0},
        {"clip_frac": -0.1},
        {"lead_frac": -0.1},
        {"road_bias_ratio": -0.1},
        {"shared_error_frac": -0.1},
        {"liars_frac": 0.5},
    ],
)
def test_a_policy_that_contradicts_itself_is_refused(assumed):
    with pytest.raises(ValueError, match=r".+"):
        PoolingPolicy(**assumed)
