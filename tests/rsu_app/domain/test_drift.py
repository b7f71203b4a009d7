from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.bundle import TrainingReference
from rsu_app.domain.drift import (
    DriftAlarm,
    DriftPolicy,
    chance_ratio_of,
    drift_report,
    kolmogorov_smirnov,
    ks_by_chance_frac,
    population_stability_index,
    psi_by_chance_ratio,
    reference_levels,
    surely_above,
    worst,
)
from rsu_app.domain.section_baseline import SectionBaseline

AT = np.linspace(0.0, 1.0, 21)
NAMES = ("speed", "steer", "misfit", "flat")
REFERENCES = st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=80).map(np.array)


def quantiles_of(values):
    return np.quantile(values, AT).astype(np.float32)


def reference_of(rows, mu, *, section_id=None):
    return TrainingReference(
        section_id=section_id,
        rows_count=len(rows),
        quantiles=tuple(tuple(quantiles_of(column).tolist()) for column in rows.T),
        mu_quantiles=tuple(quantiles_of(mu).tolist()),
    )


def traffic(count, *, seed, friction_mu=None):
    """Return features that follow the friction, as those of drives do, and the estimates."""
    rng = np.random.default_rng(seed)
    mu = rng.uniform(0.2, 0.7, count) if friction_mu is None else friction_mu * rng.uniform(0.95, 1.0, count)
    noise = rng.normal(size=(count, 3))
    rows = np.column_stack([8.0 * mu + noise[:, 0], noise[:, 1] / mu, np.exp(noise[:, 2]), np.full(count, 3.0)])
    return rows.astype(np.float32), mu


def baseline_of(count=4000, *, seed=1):
    baseline = SectionBaseline()
    for number, (values, mu) in enumerate(zip(*traffic(count, seed=seed), strict=True)):
        baseline.add(left_at_s=100.0 * number, values=values, mu=float(mu))
    return baseline.bands


def reported(rows, mu, *, reference=None, outside_count=0, **more):
    return drift_report(reference, NAMES, rows, mu, out_of_envelope_count=outside_count, total_count=len(rows), **more)


# The two distances ---------------------------------------------------------------------------------------------------


@given(st.integers(30, 300), st.integers(0, 2**32 - 1))
def test_the_reference_against_itself_is_about_zero(count, seed):
    values = np.random.default_rng(seed).normal(size=count)
    at_reference = np.quantile(values, (np.arange(count) + 0.5) / count)
    quantiles = np.quantile(at_reference, AT)
    assert population_stability_index(quantiles, at_reference) < 0.02
    assert kolmogorov_smirnov(quantiles, at_reference) < 0.06 + 1.0 / count


@given(REFERENCES)
def test_few_and_constant_values_against_themselves_are_no_shift(few):
    # Drawn again and again: what counts is that repeated quantiles do not look like a shift.
    values = np.repeat(few[:3], 200)
    quantiles = quantiles_of(values)
    assert population_stability_index(quantiles, values) < 0.1
    assert kolmogorov_smirnov(quantiles, values) < 0.06


@given(REFERENCES, st.lists(st.floats(-2e3, 2e3, width=32), min_size=1, max_size=50), st.randoms(use_true_random=False))
def test_the_order_of_the_values_does_not_matter(few, values, chance):
    shuffled = list(values)
    chance.shuffle(shuffled)
    quantiles = quantiles_of(few)
    for distance in (population_stability_index, kolmogorov_smirnov):
        assert distance(quantiles, np.array(values)) == distance(quantiles, np.array(shuffled))


@given(REFERENCES, REFERENCES)
def test_the_distances_lie_within_their_bounds(few, values):
    quantiles = quantiles_of(few)
    assert population_stability_index(quantiles, values) >= 0.0
    assert 0.0 <= kolmogorov_smirnov(quantiles, values) <= 1.0


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40), st.floats(0.5, 4.0), st.floats(-5.0, 5.0))
def test_a_unit_of_measurement_changes_nothing(values, factor, shift):
    quantiles, moved = AT, factor * np.array(values) + shift
    plain = kolmogorov_smirnov(quantiles, np.array(values))
    assert kolmogorov_smirnov(factor * AT + shift, moved) == pytest.approx(plain, abs=1e-4)


def test_the_index_of_a_known_shift_is_the_formula_s():
    # 1000 values in the lower half only: five bins of 20 %, five empty ones.
    values = np.linspace(0.0, 0.5, 1000, endpoint=False)
    full, empty = 200.5 / 1005.0, 0.5 / 1005.0
    expected = 5.0 * (full - 0.1) * np.log(full / 0.1) + 5.0 * (empty - 0.1) * np.log(empty / 0.1)
    assert population_stability_index(AT, values) == pytest.approx(expected)
    assert kolmogorov_smirnov(AT, values) == pytest.approx(0.5, abs=0.001)


def test_a_constant_that_changes_is_as_far_as_can_be():
    quantiles = np.full(21, 3.0)
    assert kolmogorov_smirnov(quantiles, np.full(50, 3.1)) == 1.0
    assert kolmogorov_smirnov(quantiles, np.full(50, 2.9)) == 1.0
    assert population_stability_index(quantiles, np.full(50, 3.1)) > 1.0


def test_values_of_32_bits_meet_the_decimals_of_a_manifest():
    # 0.1 as it is written, and as a passage holds it, differ in 64 bits.
    assert kolmogorov_smirnov(np.full(21, 0.1), np.full(40, 0.1, dtype=np.float32)) < 0.02


def test_what_is_no_number_is_left_out_of_the_distances():
    values = np.linspace(0.0, 1.0, 101)
    dirty = np.concatenate([values, [np.nan, np.inf, -np.inf]])
    assert kolmogorov_smirnov(AT, dirty) == kolmogorov_smirnov(AT, values)
    assert population_stability_index(AT, dirty) == population_stability_index(AT, values)
    assert np.isnan(kolmogorov_smirnov(AT, np.array([np.nan])))
    assert np.isnan(population_stability_index(AT, np.array([np.nan])))


def test_levels_are_linear_between_quantiles_and_even_over_repeated_ones():
    levels = reference_levels(np.array([[0.0, 1.0, 1.0, 1.0, 5.0]]), np.array([[-1.0, 0.5, 1.0, 1.0, 3.0, 9.0]]).T)
    assert levels[:, 0].tolist() == pytest.approx([0.0, 0.125, 0.375, 0.625, 0.875, 1.0])


@pytest.mark.parametrize("count", [50, 256])
def test_chance_seldom_exceeds_its_limits(count):
    rng = np.random.default_rng(5)
    known = quantiles_of(rng.normal(size=20_000))
    chance_ratio = chance_ratio_of([(count, 20_000)])
    samples = rng.normal(size=(1000, count))
    psi = np.array([population_stability_index(known, sample) for sample in samples])
    ks = np.array([kolmogorov_smirnov(known, sample) for sample in samples])
    assert 0.002 <= (psi > psi_by_chance_ratio(chance_ratio)).mean() <= 0.025
    assert 0.002 <= (ks > ks_by_chance_frac(chance_ratio)).mean() <= 0.025


def test_a_small_reference_is_uncertain_too():
    assert chance_ratio_of([(100, 100)]) == pytest.approx(0.02)
    # Two halves held against two references know as much as one held against both.
    assert chance_ratio_of([(50, 200), (50, 200)]) == pytest.approx(0.01 + 1.0 / 400.0)


def test_a_share_is_surely_above_its_limit_when_chance_hardly_does_that():
    assert not surely_above(10, 100, limit_frac=0.1)
    assert not surely_above(16, 100, limit_frac=0.1)
    assert surely_above(17, 100, limit_frac=0.1)
    assert not surely_above(0, 0, limit_frac=0.1)


# The report ----------------------------------------------------------------------------------------------------------


def test_ordinary_traffic_raises_no_alarm():
    reference = reference_of(*traffic(5000, seed=0))
    rows, mu = traffic(256, seed=2)
    report = reported(rows, mu, reference=reference, baseline=baseline_of())
    assert report.alarms == ()
    assert (report.drifted_count, report.own_drifted_count) == (0, 0)
    assert [feature.name for feature in report.features] == list(NAMES)
    assert report.estimate is not None
    assert not report.estimate.drifted


@pytest.mark.parametrize("friction_mu", [0.25, 0.4, 0.65])
def test_weather_moves_features_and_is_no_alarm(friction_mu):
    reference = reference_of(*traffic(5000, seed=0))
    rows, mu = traffic(256, seed=3, friction_mu=friction_mu)
    report = reported(rows, mu, reference=reference, baseline=baseline_of())
    assert report.drifted_count >= 1
    assert report.estimate is not None
    assert report.estimate.drifted
    assert report.own_rows_count == 256
    assert report.alarms == ()


@pytest.mark.parametrize("friction_mu", [None, 0.25])
def test_a_sensor_that_changed_is_an_alarm_in_any_weather(friction_mu):
    rows, mu = traffic(256, seed=4, friction_mu=friction_mu)
    rows[:, 2] *= 2.5
    report = reported(rows, mu, baseline=baseline_of())
    assert report.alarms == (DriftAlarm.OWN_TRAFFIC,)
    assert [feature.name for feature in report.own_features if feature.drifted] == ["misfit"]
    assert worst(report.own_features, 1)[0].name == "misfit"


def test_weather_that_the_section_has_not_had_yet_is_not_judged():
    rows, mu = traffic(200, seed=4, friction_mu=0.9)
    report = reported(rows, mu, baseline=baseline_of())
    assert (report.own_rows_count, report.own_features, report.alarms) == (0, (), ())


def test_the_share_outside_the_envelope_is_an_alarm():
    rows, mu = traffic(100, seed=2)
    assert reported(rows, mu, outside_count=12).alarms == ()
    report = reported(rows, mu, outside_count=30)
    assert report.alarms == (DriftAlarm.OUT_OF_ENVELOPE,)
    assert report.out_of_envelope_frac == 0.3


def test_estimates_beyond_those_of_the_training_are_an_alarm():
    known = traffic(5000, seed=0)
    rows, mu = traffic(100, seed=2)
    mu[:20] = 1.1
    report = reported(rows, mu, reference=reference_of(*known))
    assert DriftAlarm.ESTIMATES_OUTSIDE in report.alarms
    assert report.estimates_outside_frac == 0.2


def test_too_few_passages_are_not_judged():
    rows, mu = traffic(29, seed=2)
    mu[:] = 1.1
    report = reported(
        rows + 100.0, mu, reference=reference_of(*traffic(5000, seed=0)), outside_count=29, baseline=baseline_of()
    )
    assert (report.features, report.estimate, report.own_features, report.alarms) == ((), None, (), ())
    assert report.rows_count == report.total_count == 29


def test_too_few_passages_of_like_friction_are_not_held_against_earlier_ones():
    rows, mu = traffic(60, seed=4)
    rows[:, 2] *= 100.0
    mu[29:] = 1.4
    report = reported(rows, mu, baseline=baseline_of())
    assert (report.own_rows_count, report.own_features, report.alarms) == (29, (), ())


def test_an_empty_window_says_nothing():
    report = reported(np.empty((0, 4), dtype=np.float32), np.empty(0), reference=reference_of(*traffic(99, seed=0)))
    assert (report.rows_count, report.out_of_envelope_frac, report.alarms) == (0, 0.0, ())


def test_values_that_are_no_numbers_are_counted():
    rows, mu = traffic(100, seed=2)
    rows[:3, 1] = [np.nan, np.inf, -np.inf]
    rows[:, 0] = np.nan
    mu[5] = np.nan
    report = reported(rows, mu, reference=reference_of(*traffic(5000, seed=0)))
    assert report.not_finite_count == 103
    assert np.isnan(report.features[0].psi_ratio)
    assert not report.features[0].drifted
    assert not report.features[1].drifted
    assert [feature.name for feature in worst(report.features, 9)].count("speed") == 0


def test_a_reference_of_the_road_itself_is_told():
    rows, mu = traffic(100, seed=2)
    everywhere = reference_of(*traffic(500, seed=0))
    assert not reported(rows, mu, reference=everywhere).own_road
    assert reported(rows, mu, reference=replace(everywhere, section_id="bend")).own_road


def test_features_of_the_road_are_not_compared():
    known, mu = traffic(500, seed=0)
    with_road = reference_of(np.column_stack([known, np.full(500, 7.0)]), mu)
    assert len(reported(*traffic(100, seed=2), reference=with_road).features) == 4


def test_limits_are_the_policy_s():
    rows, mu = traffic(256, seed=4)
    rows[:, 2] *= 2.5
    bold = DriftPolicy(own_drifted_limit_frac=0.5, psi_limit_ratio=0.01, ks_limit_frac=0.01)
    assert reported(rows, mu, baseline=baseline_of(), policy=bold).alarms == ()
