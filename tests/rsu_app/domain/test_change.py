from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain.change import ChangeKind, ChangePolicy, ChangeState, changes, mu_since_change, observe

POLICY = ChangePolicy()


def traffic(rng, count, base_mu, *, noise_ratio=0.05):
    return base_mu * rng.uniform(0.8, 1.0, count) * np.exp(noise_ratio * rng.standard_normal(count))


def minutes(count):
    return 60.0 * np.arange(count)


def dropped(rng, *, before_count=60, after_count=30, drop_frac=0.4):
    mu = np.concatenate([traffic(rng, before_count, 0.5), traffic(rng, after_count, 0.5 * (1.0 - drop_frac))])
    return 60.0 * np.arange(len(mu)), mu


@pytest.mark.parametrize(("drop_frac", "vehicles_count"), [(0.2, 8), (0.4, 6), (0.6, 6)])
def test_a_drop_is_seen_after_so_many_vehicles(drop_frac, vehicles_count):
    rng = np.random.default_rng(7)
    delays = []
    for _ in range(60):
        left_at_s, mu = dropped(rng, drop_frac=drop_frac)
        found = [one for one in changes(left_at_s, mu, policy=POLICY) if one.seen_at_s >= 60.0 * 60]
        assert len(found) <= 2
        if found:
            assert found[0].kind is ChangeKind.DROP
            delays.append(found[0].seen_at_s / 60.0 - 59.0)
    assert len(delays) >= 58
    assert np.median(delays) == pytest.approx(vehicles_count, abs=1.0)


def test_the_change_is_dated_to_where_it_began(rng):
    left_at_s, mu = dropped(rng)
    (change,) = changes(left_at_s, mu, policy=POLICY)
    assert change.since_s == pytest.approx(60.0 * 60, abs=120.0)
    assert change.vehicles_count == pytest.approx((change.seen_at_s - change.since_s) / 60.0 + 1.0)


def test_months_without_a_change_are_quiet(rng):
    state, found = ChangeState(), []
    for at_s, log_mu in enumerate(np.log(traffic(rng, 60_000, 0.5)).tolist()):
        state, change = observe(state, log_mu=log_mu, at_s=float(at_s), policy=POLICY)
        found += [change] if change else []
    assert found == []


def test_a_rise_needs_more_vehicles_than_a_drop(rng):
    left_at_s, mu = dropped(rng)
    (drop,) = changes(left_at_s, mu, policy=POLICY)
    (rise,) = changes(left_at_s, mu[::-1].copy(), policy=POLICY)
    assert rise.kind is ChangeKind.RISE
    assert rise.vehicles_count > 1.5 * drop.vehicles_count


@given(st.lists(st.tuples(st.integers(0, 50), st.floats(0.1, 1.2)), max_size=60), st.randoms(use_true_random=False))
def test_the_order_of_arrival_does_not_matter(entries, chance):
    shuffled = list(entries)
    chance.shuffle(shuffled)
    results = []
    for order in (entries, shuffled):
        left_at_s = np.array([float(at) for at, _ in order])
        mu = np.array([mu for _, mu in order])
        results.append((changes(left_at_s, mu, policy=POLICY), mu_since_change(left_at_s, mu, policy=POLICY).tolist()))
    assert results[0] == results[1]


@given(st.integers(0, 2**32 - 1), st.floats(0.3, 3.0))
def test_scaling_every_estimate_changes_no_change(seed, factor):
    left_at_s, mu = dropped(np.random.default_rng(seed))
    assert changes(left_at_s, factor * mu, policy=POLICY) == changes(left_at_s, mu, policy=POLICY)


@given(st.integers(0, 2**32 - 1))
def test_a_drop_and_a_rise_are_mirror_images_at_equal_thresholds(seed):
    even = ChangePolicy(rise_threshold_ratio=0.5)
    left_at_s, mu = dropped(np.random.default_rng(seed))
    down, up = changes(left_at_s, mu, policy=even), changes(left_at_s, 1.0 / mu, policy=even)
    assert [(c.since_s, c.seen_at_s) for c in down] == [(c.since_s, c.seen_at_s) for c in up]
    assert all(a.kind is not b.kind for a, b in zip(down, up, strict=True))


@pytest.mark.parametrize("count", [0, 1, 13])
def test_too_few_vehicles_tell_of_no_change(count):
    mu = np.linspace(0.9, 0.1, 13)[:count]
    assert changes(minutes(count), mu, policy=POLICY) == ()
    assert mu_since_change(minutes(count), mu, policy=POLICY).tolist() == sorted(mu)


def test_five_absurd_values_are_no_change(rng):
    mu = traffic(rng, 60, 0.5)
    mu[40:45] = 0.01
    assert changes(minutes(60), mu, policy=POLICY) == ()


def test_the_window_is_cut_where_the_friction_fell(rng):
    left_at_s, mu = dropped(rng, after_count=20)
    since = mu_since_change(left_at_s, mu, policy=POLICY)
    assert len(since) == pytest.approx(20, abs=2)
    assert np.median(since) == pytest.approx(0.27, rel=0.07)
    assert since.tolist() == sorted(since)


def test_the_newest_ten_stay_whatever_the_change(rng):
    left_at_s, mu = dropped(rng, after_count=7, drop_frac=0.6)
    since = mu_since_change(left_at_s, mu, policy=POLICY)
    assert since.tolist() == sorted(mu[-10:])
    # Seven of ten found the new friction, so the median is theirs.
    assert np.median(since) < 0.5 * 0.5


def test_few_vehicles_an_hour_need_a_longer_memory(rng):
    left_at_s, mu = dropped(rng, before_count=30, after_count=8)
    left_at_s = 4.0 * left_at_s  # fifteen an hour
    counted_from_s = left_at_s[-1] - 3600.0
    hour = left_at_s >= counted_from_s
    assert len(mu_since_change(left_at_s[hour], mu[hour], policy=POLICY)) == np.count_nonzero(hour)
    since = mu_since_change(left_at_s, mu, policy=POLICY, counted_from_s=counted_from_s)
    assert since.tolist() == sorted(mu[-10:])


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 8000.0))
def test_what_is_older_than_the_window_never_counts(seed, counted_from_s):
    left_at_s, mu = dropped(np.random.default_rng(seed))
    since = mu_since_change(left_at_s, mu, policy=POLICY, counted_from_s=counted_from_s)
    assert set(since.tolist()) <= set(mu[left_at_s >= counted_from_s].tolist())
    assert len(since) >= min(10, int(np.count_nonzero(left_at_s >= counted_from_s)))


def test_the_latest_of_two_changes_counts(rng):
    mu = np.concatenate([traffic(rng, 60, 0.6), traffic(rng, 40, 0.3), traffic(rng, 40, 0.6)])
    left_at_s = minutes(len(mu)) / 3.0
    kinds = [change.kind for change in changes(left_at_s, mu, policy=POLICY)]
    assert kinds == [ChangeKind.DROP, ChangeKind.RISE]
    assert np.median(mu_since_change(left_at_s, mu, policy=POLICY)) == pytest.approx(0.54, rel=0.05)


def test_only_the_newest_are_watched(rng):
    left_at_s, mu = dropped(rng, before_count=60, after_count=60)
    assert changes(left_at_s, mu, policy=ChangePolicy(watched_count=50)) == ()


@pytest.mark.parametrize(
    "decisions",
    [
        {"slack_ratio": 0.3},
        {"slack_ratio": 0.0},
        {"drop_threshold_ratio": 2.0},
        {"reference_from_count": 0},
        {"reference_from_count": 31},
        {"lag_count": 0},
        {"kept_count": 0},
        {"watched_count": 0},
    ],
)
def test_a_policy_that_contradicts_itself_is_refused(decisions):
    with pytest.raises(ValueError, match=r".+"):
        ChangePolicy(**decisions)
