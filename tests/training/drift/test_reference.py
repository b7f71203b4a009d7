import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.drift.reference import FEWEST_ROWS_COUNT, learn_references


def drives(count, *, seed=0, columns=3):
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, 1.0, (count, columns)), rng.uniform(0.2, 0.7, count)


def test_a_known_road_with_enough_drives_has_a_reference_of_its_own():
    features, mu = drives(FEWEST_ROWS_COUNT + 150)
    roads = ["bend"] * FEWEST_ROWS_COUNT + ["hairpin"] * 149 + ["random"]
    found = learn_references(features, mu, roads, known_sections=["hairpin", "bend"])
    assert [(each.section_id, each.rows_count) for each in found] == [(None, 350), ("bend", 200)]
    assert found[1].quantiles[0][0] == pytest.approx(features[:200, 0].min(), rel=1e-6)
    assert found[0].mu_quantiles[10] == pytest.approx(np.median(mu), rel=1e-6)


def test_roads_that_nobody_serves_count_among_all_roads_only():
    features, mu = drives(500)
    assert [each.section_id for each in learn_references(features, mu, ["bend"] * 500, known_sections=[])] == [None]


def test_the_order_of_the_drives_does_not_matter():
    features, mu = drives(450)
    roads = np.array(["bend", "hairpin"] * 225)
    order = np.random.default_rng(3).permutation(450)
    shuffled = learn_references(
        features[order], mu[order], roads[order].tolist(), known_sections=["hairpin", "bend", "bend"]
    )
    assert shuffled == learn_references(features, mu, roads.tolist(), known_sections=["bend", "hairpin"])


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), st.integers(2, 40))
def test_quantiles_never_fall_and_are_short_numbers_of_32_bits(values, levels_count):
    column = np.array(values)
    (known,) = learn_references(
        column[:, None], np.full(len(values), 0.5), [""] * len(values), known_sections=[], levels_count=levels_count
    )
    quantiles = known.quantiles[0]
    assert len(quantiles) == len(known.mu_quantiles) == levels_count
    assert list(quantiles) == sorted(quantiles)
    assert np.float32(quantiles[0]) == np.float32(column.min())
    assert np.float32(quantiles[-1]) == np.float32(column.max())
    assert all(repr(value) == repr(float(str(np.float32(value)))) for value in quantiles)


def test_numbers_that_are_none_are_refused():
    features, mu = drives(10)
    features[3, 1] = np.nan
    with pytest.raises(ValueError, match="10 rows"):
        learn_references(features, mu, ["bend"] * 10, known_sections=[])
    with pytest.raises(ValueError, match="0 rows"):
        learn_references(features[:0], mu[:0], [], known_sections=[])
