import numpy as np
import pytest

from rsu_app.domain.section_baseline import BAND_RATIO, SPELL_S, SectionBaseline, band_of, learned_bands


def test_a_band_is_learned_when_it_has_enough_passages():
    baseline = SectionBaseline(band_rows_count=3)
    added = [baseline.add(left_at_s=0.0, values=[float(number)], mu=0.5) for number in (1, 5, 3, 9)]
    assert added == [True, True, True, False]
    (band,) = baseline.bands
    assert band.mu_low <= 0.5 < band.mu_high
    assert band.mu_high / band.mu_low == pytest.approx(BAND_RATIO)
    assert band.rows_count == 3
    assert band.quantile_values[0, [0, 10, -1]].tolist() == [1.0, 3.0, 5.0]
    assert baseline.gathering_count == 0


def test_each_friction_has_a_band_of_its_own():
    baseline = SectionBaseline(band_rows_count=2)
    for mu in (0.7, 0.2, 0.4, 0.7, 0.2):
        baseline.add(left_at_s=0.0, values=[mu], mu=mu)
    assert [float(band.quantile_values[0, 0]) for band in baseline.bands] == pytest.approx([0.2, 0.7])
    assert baseline.gathering_count == 1
    assert band_of(0.4) not in {band_of(0.2), band_of(0.7)}


def test_one_hour_does_not_make_a_band_alone():
    baseline = SectionBaseline(band_rows_count=4, spell_rows_count=2)
    assert [baseline.add(left_at_s=10.0 * n, values=[1.0], mu=0.5) for n in range(3)] == [True, True, False]
    assert not baseline.bands
    for number in range(2):
        assert baseline.add(left_at_s=SPELL_S + number, values=[2.0], mu=0.5)
    assert [band.quantile_values[0, [0, -1]].tolist() for band in baseline.bands] == [[1.0, 2.0]]


def test_the_same_passages_give_the_same_bands_again():
    rng = np.random.default_rng(0)
    rows, mu = rng.normal(size=(900, 4)).astype(np.float32), rng.uniform(0.4, 0.6, 900)
    left_at_s = np.linspace(0.0, 54_000.0, 900)
    first, again = (learned_bands(left_at_s=left_at_s, rows=rows, mu=mu) for _ in range(2))
    assert len(first) == 2
    assert all(np.array_equal(a.quantile_values, b.quantile_values) for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize(
    ("left_at_s", "value", "mu"),
    [(np.nan, 1.0, 0.5), (0.0, np.inf, 0.5), (0.0, 1.0, np.nan), (0.0, 1.0, 0.0)],
)
def test_a_passage_without_a_number_teaches_nothing(left_at_s, value, mu):
    with pytest.raises(ValueError, match="teaches nothing"):
        SectionBaseline().add(left_at_s=left_at_s, values=[value], mu=mu)
