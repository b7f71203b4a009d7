"""The bag of samples and its statistics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from roadgrip.features import NEWEST_TABLE, PAPER_TABLE, STATISTICS, summary_for
from roadgrip.records import QualityFlag
from vehicle_client.estimation.summary import KinematicSignals, kinematic_summary

N = 400
GRIP = np.linspace(0.1, 0.2, len(NEWEST_TABLE.kinematic) - len(PAPER_TABLE.kinematic))
NAMES = ("steer_rad", "sideslip_rad", "sideslip_rate_radps", "yaw_rate_excess_radps", "speed_mps")


def signals_of(bag) -> KinematicSignals:
    rest = np.zeros(bag.shape[1])
    return KinematicSignals(
        **dict(zip(NAMES, bag, strict=True)),
        velocity_x_mps=rest,
        velocity_y_mps=rest,
        yaw_rate_radps=rest,
        chassis_roll_rad=rest,
        straightness_1ps=rest,
    )


def summary_of(bag, inside=None):
    everything = np.ones(bag.shape[1], dtype=bool)
    return kinematic_summary(
        signals_of(bag), everything if inside is None else inside, grip_features=GRIP, duration_s=4.0
    )


def test_the_columns_are_the_tables_and_the_numbers_scipys():
    bag = np.random.default_rng(1).gamma(2.0, size=(5, N))
    values = dict(zip((f.name for f in NEWEST_TABLE.kinematic), summary_of(bag).values, strict=True))
    speed, slip = bag[4], bag[1]
    assert values["speed_mean_mps"] == pytest.approx(np.mean(speed))
    assert values["speed_q80_mps"] == pytest.approx(np.quantile(speed, 0.8))
    assert values["sideslip_std_rad"] == pytest.approx(np.std(slip))
    assert values["sideslip_skewness"] == pytest.approx(stats.skew(slip))
    assert values["sideslip_kurtosis"] == pytest.approx(stats.kurtosis(slip))
    assert values["steer_min_rad"] == bag[0].min()
    assert values["yaw_rate_excess_max_radps"] == bag[3].max()
    assert values["sideslip_rate_median_radps"] == pytest.approx(np.median(bag[2]))


def statistics_in(summary):
    """Return the statistics of a summary, a signal a row. (5, 11)"""
    return np.array(summary.values)[NEWEST_TABLE.statistics_columns]


@pytest.mark.parametrize("draw", ["normal", "exponential", "uniform", "standard_cauchy"])
def test_every_statistic_is_scipys_whatever_the_distribution(draw):
    bag = getattr(np.random.default_rng(5), draw)(size=(5, N))
    found = statistics_in(summary_of(bag))
    quantiles = stats.mstats.mquantiles(bag, [0.2, 0.4, 0.6, 0.8, 0.5], alphap=1, betap=1, axis=1)
    described = stats.describe(bag, axis=1, ddof=0)
    expected = {
        "mean": described.mean,
        "std": np.sqrt(described.variance),
        "q20": quantiles[:, 0],
        "q40": quantiles[:, 1],
        "q60": quantiles[:, 2],
        "q80": quantiles[:, 3],
        "min": described.minmax[0],
        "median": quantiles[:, 4],
        "max": described.minmax[1],
        "skewness": described.skewness,
        "kurtosis": described.kurtosis,
    }
    for i, name in enumerate(STATISTICS):
        assert np.allclose(found[:, i], expected[name], rtol=1e-9, atol=1e-12), name


@given(seed=st.integers(0, 2**32 - 1))
def test_the_order_of_samples_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    bag = rng.normal(size=(5, 50))
    assert summary_of(bag[:, rng.permutation(50)]).values == summary_of(bag).values


@given(seed=st.integers(0, 2**32 - 1))
def test_the_mirror_swaps_minimum_and_maximum_and_turns_the_skew(seed):
    bag = np.random.default_rng(seed).normal(size=(5, 60))
    here = statistics_in(summary_of(bag))
    there = statistics_in(summary_of(-bag))
    column = {name: i for i, name in enumerate(STATISTICS)}
    turned = {"mean": "mean", "q20": "q80", "q40": "q60", "q60": "q40", "q80": "q20", "min": "max", "max": "min"}
    turned |= {"median": "median", "skewness": "skewness"}
    for name, partner in turned.items():
        assert np.allclose(there[:, column[name]], -here[:, column[partner]], atol=1e-12)
    for name in ("std", "kurtosis"):
        assert np.allclose(there[:, column[name]], here[:, column[name]], atol=1e-9)


def test_samples_outside_do_not_count():
    bag = np.random.default_rng(2).normal(size=(5, 100))
    inside = np.arange(100) < 60
    assert summary_of(bag, inside).values == summary_of(bag[:, :60]).values


def test_the_record_says_what_it_was_made_for():
    summary = kinematic_summary(
        signals_of(np.ones((5, 10))),
        np.ones(10, dtype=bool),
        grip_features=GRIP,
        duration_s=3.5,
        quality=QualityFlag.NO_GNSS,
    )
    assert (summary.table_digest, summary.duration_s, summary.quality) == (
        NEWEST_TABLE.digest,
        3.5,
        QualityFlag.NO_GNSS,
    )


def test_the_grip_follows_the_papers_statistics():
    summary = summary_of(np.random.default_rng(3).normal(size=(5, N)))
    paper = summary_for(summary, PAPER_TABLE)
    assert summary.values == (*paper.values, *GRIP.tolist())


def test_an_empty_bag_is_refused():
    with pytest.raises(ValueError, match="no samples"):
        summary_of(np.ones((5, 10)), np.zeros(10, dtype=bool))
