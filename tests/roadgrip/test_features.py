import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from roadgrip.errors import FeatureTableError
from roadgrip.features import (
    FEATURE_NAMES,
    FEATURES,
    KINEMATIC_FEATURES,
    ROAD_FEATURES,
    STATISTICS,
    TABLE_DIGEST,
    check_digest,
    road_features,
    statistics_of,
)
from tests.roadgrip.roads import PAPER_ROADS, circle_section, packaged

samples = arrays(np.float64, st.integers(1, 200), elements=st.floats(-1e3, 1e3, width=32))


def test_the_table_has_the_papers_78_columns():
    assert (len(KINEMATIC_FEATURES), len(ROAD_FEATURES), len(FEATURES)) == (55, 23, 78)
    assert len(set(FEATURE_NAMES)) == 78


def test_names_end_in_their_unit_and_shapes_have_none():
    for feature in FEATURES:
        assert re.fullmatch(r"[a-z0-9_]+", feature.name)
        assert feature.minimum < feature.maximum
        if feature.unit:
            assert feature.name.endswith(f"_{feature.unit}")
        else:
            assert feature.name.endswith(("_skewness", "_kurtosis"))


def test_the_digest_is_the_one_that_trained_models_and_old_vehicles_know():
    # Change it on purpose only: every bundle and every summary made before is refused from then on.
    assert TABLE_DIGEST == "1b7bc963ba3dd63c"


def test_a_digest_of_another_table_is_refused_and_both_are_named():
    check_digest(TABLE_DIGEST, subject="bundle")
    with pytest.raises(FeatureTableError, match=f"summary 7 .* 0123456789abcdef.* {TABLE_DIGEST}"):
        check_digest("0123456789abcdef", subject="summary 7")


def test_statistics_agree_with_scipy(rng):
    for values in (rng.normal(3.0, 2.0, 1000), rng.exponential(size=77), rng.integers(0, 3, 50).astype(float)):
        mean, std, q20, q40, q60, q80, low, median, high, skewness, kurtosis = statistics_of(values)
        assert [mean, std] == pytest.approx([values.mean(), values.std()])
        assert [q20, q40, q60, q80] == pytest.approx(np.quantile(values, [0.2, 0.4, 0.6, 0.8]))
        assert [low, median, high] == pytest.approx([values.min(), np.median(values), values.max()])
        assert [skewness, kurtosis] == pytest.approx([stats.skew(values), stats.kurtosis(values)])


@given(samples, st.integers(0, 2**32 - 1))
def test_the_order_of_samples_does_not_matter_to_the_last_bit(values, seed):
    shuffled = np.random.default_rng(seed).permutation(values)
    assert statistics_of(shuffled).tobytes() == statistics_of(values).tobytes()


def test_zeros_of_either_sign_are_the_same():
    assert statistics_of(np.array([0.0, -0.0])).tobytes() == statistics_of(np.array([-0.0, 0.0])).tobytes()


@given(samples)
def test_quantiles_are_ordered_and_a_mirror_image_mirrors_them(values):
    mean, std, q20, q40, q60, q80, low, median, high, _, kurtosis = statistics_of(values)
    assert low <= q20 <= q40 <= median <= q60 <= q80 <= high
    assert std >= 0.0
    assert kurtosis >= -2.0 - 1e-6
    other = statistics_of(-values)
    tolerance = 1e-9 * max(1.0, abs(low), abs(high))
    assert other[:9] == pytest.approx([-mean, std, -q80, -q60, -q40, -q20, -high, -median, -low], abs=tolerance)


@given(samples)
def test_statistics_lie_within_the_ranges_the_table_allows(values):
    within = np.clip(values, -1.0, 1.0)
    for feature, value in zip(KINEMATIC_FEATURES[: len(STATISTICS)], statistics_of(within), strict=True):
        assert feature.minimum <= value <= feature.maximum


def test_a_constant_signal_has_no_shape():
    assert statistics_of(np.full(100, 1e6 + 0.1))[[1, 9, 10]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf]])
def test_statistics_of_nothing_or_of_what_is_not_finite_are_an_error(values):
    with pytest.raises(ValueError, match="statistics of"):
        statistics_of(np.array(values))


def test_road_features_of_a_circle_are_known():
    section = circle_section(100.0, turn_rad=2.0)
    found = dict(zip([f.name for f in ROAD_FEATURES], road_features(section), strict=True))
    assert found["curvature_mean_1pm"] == pytest.approx(0.01, rel=0.01)
    assert found["curvature_std_1pm"] < 2e-4
    assert found["road_difficulty_median_ratio"] == pytest.approx(72.0**2 / 127 / 100 - 0.14, rel=0.02)
    assert found["section_length_m"] == pytest.approx(200.0, abs=0.1)


@pytest.mark.parametrize("name", PAPER_ROADS)
def test_road_features_of_the_packaged_roads_lie_within_the_table(name):
    for feature, value in zip(ROAD_FEATURES, road_features(packaged(name)), strict=True):
        assert feature.minimum <= value <= feature.maximum, feature.name
