import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from roadgrip.errors import FeatureTableError
from roadgrip.features import (
    NEWEST_TABLE,
    PAPER_TABLE,
    STATISTICS,
    TABLES,
    FeatureTable,
    older_summary,
    road_features,
    statistics_of,
    summary_among,
    summary_for,
    table_of,
)
from roadgrip.records import KinematicSummary, QualityFlag
from tests.roadgrip.roads import PAPER_ROADS, circle_section, packaged
from tests.roadgrip.tables import WIDER_TABLE

samples = arrays(np.float64, st.integers(1, 200), elements=st.floats(-1e3, 1e3, width=32))


EVERY_TABLE = pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: f"version-{table.version}")
WITHOUT_UNIT = ("_skewness", "_kurtosis", "_ratio", "_frac", "_mu", "_gain", "_weight", "_likelihood", "_count")


def summary_of(table: FeatureTable) -> KinematicSummary:
    return KinematicSummary(
        tuple(float(i) for i in range(len(table.kinematic))), table.digest, 30.0, QualityFlag.NO_GNSS
    )


def test_the_papers_table_has_its_78_columns():
    assert (len(PAPER_TABLE.kinematic), len(PAPER_TABLE.road), len(PAPER_TABLE)) == (55, 23, 78)


@EVERY_TABLE
def test_names_are_unique_and_end_in_their_unit(table):
    assert len(set(table.names)) == len(table)
    for feature in table.features:
        assert re.fullmatch(r"[a-z0-9_]+", feature.name)
        assert feature.minimum < feature.maximum
        assert feature.name.endswith(f"_{feature.unit}" if feature.unit else WITHOUT_UNIT), feature.name


def test_the_papers_digest_is_the_one_that_trained_models_and_old_vehicles_know():
    # Never change it: every bundle and every summary made before would be refused.
    assert PAPER_TABLE.digest == "1b7bc963ba3dd63c"


def test_tables_are_found_by_their_digest_oldest_first():
    assert all(table.digest == digest for digest, table in TABLES.items())
    versions = [table.version for table in TABLES.values()]
    assert versions == sorted(set(versions))
    assert list(TABLES.values())[-1] is NEWEST_TABLE


@EVERY_TABLE
def test_the_newest_table_can_say_what_every_older_one_said(table):
    assert NEWEST_TABLE.covers(table)
    assert [NEWEST_TABLE.names[i] for i in NEWEST_TABLE.columns_of(table)] == list(table.names)


def test_a_table_this_software_does_not_speak_is_refused_and_both_are_named():
    assert table_of(PAPER_TABLE.digest, subject="bundle") is PAPER_TABLE
    with pytest.raises(FeatureTableError, match=f"summary 7 .* 0123456789abcdef.* {PAPER_TABLE.digest}"):
        table_of("0123456789abcdef", subject="summary 7")


def test_a_change_of_any_column_changes_the_digest():
    feature = PAPER_TABLE.kinematic[0]
    for change in ({"name": "other_rad"}, {"unit": "m"}, {"minimum": -2.0}, {"maximum": 2.0}):
        other = replace(PAPER_TABLE, kinematic=(replace(feature, **change), *PAPER_TABLE.kinematic[1:]))
        assert other.digest != PAPER_TABLE.digest
    assert replace(PAPER_TABLE, version=9).digest != PAPER_TABLE.digest


def test_columns_of_an_older_table_are_selected_by_name():
    row = np.arange(len(WIDER_TABLE), dtype=float)
    selected = row[WIDER_TABLE.columns_of(PAPER_TABLE)]
    assert selected.tolist() == [*range(55), *range(len(WIDER_TABLE.kinematic), len(WIDER_TABLE))]
    with pytest.raises(FeatureTableError, match=WIDER_TABLE.kinematic[55].name):
        PAPER_TABLE.columns_of(WIDER_TABLE)


def test_statistics_stand_where_the_signals_are_and_nowhere_else():
    for table in (PAPER_TABLE, WIDER_TABLE):
        assert table.statistics_columns.shape == (5, len(STATISTICS))
        assert sorted(table.statistics_columns.ravel().tolist()) == list(range(55))


def test_a_summary_is_told_in_older_words_and_never_in_newer_ones(wider_table):
    newer = summary_of(wider_table)
    older = summary_for(newer, PAPER_TABLE)
    assert (older.values, older.table_digest) == (newer.values[:55], PAPER_TABLE.digest)
    assert (older.duration_s, older.quality) == (newer.duration_s, newer.quality)
    assert summary_for(newer, wider_table) is newer
    with pytest.raises(FeatureTableError, match=r"lacks columns of .*"):
        summary_for(older, wider_table)


def test_both_ends_agree_on_the_newest_table_they_share(wider_table):
    newer, older = summary_of(wider_table), summary_of(PAPER_TABLE)
    both = (PAPER_TABLE.digest, wider_table.digest)
    assert summary_among(newer, both) is newer
    assert summary_among(newer, (PAPER_TABLE.digest, "0" * 16)) == summary_for(newer, PAPER_TABLE)
    assert summary_among(older, both) is older
    assert summary_among(older, (wider_table.digest,)) is None
    assert summary_among(newer, ("0" * 16,)) is None


def test_the_next_older_words_for_a_summary(wider_table):
    newer = summary_of(wider_table)
    assert older_summary(newer) == summary_for(newer, list(TABLES.values())[-2])
    assert older_summary(summary_of(next(iter(TABLES.values())))) is None
    assert older_summary(replace(newer, table_digest="0" * 16)) is None


def test_a_summary_of_a_table_not_spoken_here_goes_as_it_is_or_not_at_all():
    stranger = replace(summary_of(PAPER_TABLE), table_digest="0" * 16)
    assert summary_among(stranger, ("0" * 16,)) is stranger
    assert summary_among(stranger, (PAPER_TABLE.digest,)) is None
    with pytest.raises(FeatureTableError, match="the summary was made for feature table 0000"):
        summary_for(stranger, PAPER_TABLE)


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
    for feature, value in zip(PAPER_TABLE.kinematic[: len(STATISTICS)], statistics_of(within), strict=True):
        assert feature.minimum <= value <= feature.maximum


def test_a_constant_signal_has_no_shape():
    assert statistics_of(np.full(100, 1e6 + 0.1))[[1, 9, 10]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf]])
def test_statistics_of_nothing_or_of_what_is_not_finite_are_an_error(values):
    with pytest.raises(ValueError, match="statistics of"):
        statistics_of(np.array(values))


def test_road_features_of_a_circle_are_known():
    section = circle_section(100.0, turn_rad=2.0)
    found = dict(zip([f.name for f in PAPER_TABLE.road], road_features(section, PAPER_TABLE), strict=True))
    assert found["curvature_mean_1pm"] == pytest.approx(0.01, rel=0.01)
    assert found["curvature_std_1pm"] < 2e-4
    assert found["road_difficulty_median_ratio"] == pytest.approx(72.0**2 / 127 / 100 - 0.14, rel=0.02)
    assert found["section_length_m"] == pytest.approx(200.0, abs=0.1)


@EVERY_TABLE
@pytest.mark.parametrize("name", PAPER_ROADS)
def test_road_features_of_the_packaged_roads_lie_within_the_table(name, table):
    for feature, value in zip(table.road, road_features(packaged(name), table), strict=True):
        assert feature.minimum <= value <= feature.maximum, feature.name
