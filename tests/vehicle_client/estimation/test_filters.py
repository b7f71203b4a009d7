"""Smoothing without delay."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg, signal

from tests.vehicle_client.synthetic import clock_s
from vehicle_client.estimation.filters import (
    EDGE_SAMPLES_COUNT,
    LowPass,
    integral,
    lowpass_taps,
    rate_of_change,
    slow_part,
    smoothed,
)

seeds = st.integers(0, 2**32 - 1)
lowpasses = st.sampled_from(LowPass)


def test_the_taps_are_those_of_a_hamming_windowed_sinc():
    assert np.allclose(lowpass_taps(), signal.firwin(31, 10.0, fs=100.0, window="hamming"), atol=1e-15)


def test_smoothing_is_the_filter_run_forward_and_backward():
    noise = np.random.default_rng(1).normal(size=500).cumsum()
    reference = signal.filtfilt(lowpass_taps(), [1.0], noise, padtype="odd", padlen=120)
    assert np.allclose(smoothed(noise), reference, atol=1e-12)


@pytest.mark.parametrize("samples_count", [200, 3000])
def test_the_butterworth_reading_is_the_filter_run_forward_and_backward(samples_count):
    noise = np.random.default_rng(1).normal(size=samples_count).cumsum()
    sections = signal.butter(30, 10.0, fs=100.0, output="sos")
    reference = signal.sosfiltfilt(sections, np.pad(noise, 2000, mode="reflect", reflect_type="odd"), padlen=0)
    assert np.allclose(smoothed(noise, LowPass.BUTTERWORTH), reference[2000:-2000], atol=1e-8)


@given(value=st.floats(-1e6, 1e6), count=st.integers(EDGE_SAMPLES_COUNT + 1, 300), lowpass=lowpasses)
def test_a_constant_stays_constant_up_to_its_ends(value, count, lowpass):
    assert np.allclose(smoothed(np.full(count, value), lowpass), value, rtol=1e-12, atol=1e-9)


@given(level=st.floats(-100, 100), slope=st.floats(-1, 1), lowpass=lowpasses)
def test_a_straight_line_stays_straight_up_to_its_ends(level, slope, lowpass):
    line = level + slope * np.arange(200.0)
    assert np.allclose(smoothed(line, lowpass), line, atol=1e-8)


@given(seed=seeds, lowpass=lowpasses)
def test_smoothing_knows_no_direction_of_time(seed, lowpass):
    noise = np.random.default_rng(seed).normal(size=120)
    assert np.allclose(smoothed(noise[::-1], lowpass), smoothed(noise, lowpass)[::-1], atol=1e-11)


@given(seed=seeds, lowpass=lowpasses)
def test_smoothing_is_linear_and_keeps_the_mirror(seed, lowpass):
    a, b = np.random.default_rng(seed).normal(size=(2, 100))
    both = 2.0 * smoothed(a, lowpass) - 3.0 * smoothed(b, lowpass)
    assert np.allclose(smoothed(2.0 * a - 3.0 * b, lowpass), both, atol=1e-11)
    assert np.array_equal(smoothed(-a, lowpass), -smoothed(a, lowpass))


@pytest.mark.parametrize(
    ("lowpass", "frequency_hz", "gain"),
    [
        (LowPass.HAMMING_FIR, 1.0, 1.0),
        (LowPass.HAMMING_FIR, 10.0, 0.25),
        (LowPass.HAMMING_FIR, 20.0, 0.0),
        (LowPass.BUTTERWORTH, 9.0, 1.0),
        (LowPass.BUTTERWORTH, 10.0, 0.5),
        (LowPass.BUTTERWORTH, 11.0, 0.0),
        (LowPass.BUTTERWORTH, 50.0, 0.0),
    ],
)
def test_slow_motion_passes_and_shaking_does_not(lowpass, frequency_hz, gain):
    wave = np.cos(2.0 * np.pi * frequency_hz * np.arange(3000) / 100.0)
    inside = slice(1000, -1000)
    measured = smoothed(wave, lowpass)[inside] @ wave[inside] / (wave[inside] @ wave[inside])
    assert measured == pytest.approx(gain, abs=0.01)


@given(at=st.integers(0, 299))
def test_one_nan_spreads_at_least_thirty_and_at_most_61_samples_either_way(at):
    holed = np.zeros(300)
    holed[at] = np.nan
    # At an end it is the point of symmetry, and the extension beyond holds it too.
    spread = np.flatnonzero(np.isnan(smoothed(holed)))
    assert set(range(max(0, at - 30), min(300, at + 31))) <= set(spread.tolist())
    assert max(at - spread.min(), spread.max() - at) <= 61 + (30 if at in {0, 299} else 0)


@given(seed=seeds, count=st.integers(EDGE_SAMPLES_COUNT + 1, 200))
def test_any_number_of_samples_is_smoothed_as_numpy_convolves(seed, count):
    noise = np.random.default_rng(seed).normal(size=count)
    before, after = 2.0 * noise[0] - noise[30:0:-1], 2.0 * noise[-1] - noise[-2:-32:-1]
    both_ways = np.convolve(lowpass_taps(), lowpass_taps())
    expected = np.convolve(np.concatenate([before, noise, after]), both_ways, mode="valid")
    assert np.allclose(smoothed(noise), expected, rtol=1e-12, atol=1e-13)


def test_ten_minutes_are_smoothed_as_exactly():
    walk = np.random.default_rng(3).normal(size=60_000).cumsum()
    reference = signal.filtfilt(lowpass_taps(), [1.0], walk, padtype="odd", padlen=60)
    assert np.allclose(smoothed(walk), reference, rtol=1e-12, atol=1e-10)


def test_one_nan_spreads_everywhere_with_the_butterworth_filter():
    holed = np.zeros(200)
    holed[100] = np.nan
    assert np.isnan(smoothed(holed, LowPass.BUTTERWORTH)).all()


@pytest.mark.parametrize("lowpass", LowPass)
def test_too_few_samples_are_refused(lowpass):
    with pytest.raises(ValueError, match="too few"):
        smoothed(np.zeros(EDGE_SAMPLES_COUNT), lowpass)


@given(value=st.floats(-100, 100), count=st.integers(1, 200), crossover_hz=st.floats(0.01, 10.0))
def test_the_slow_part_of_a_constant_is_the_constant(value, count, crossover_hz):
    assert np.allclose(slow_part(np.full(count, value), crossover_hz=crossover_hz), value, atol=1e-8)


def test_at_the_crossover_half_of_a_wave_is_slow():
    wave = np.cos(2.0 * np.pi * 0.5 * np.arange(20_000) / 100.0)
    inside = slice(5_000, 15_000)
    slow = slow_part(wave, crossover_hz=0.5)
    assert slow[inside] @ wave[inside] / (wave[inside] @ wave[inside]) == pytest.approx(0.5, abs=1e-3)


@given(seed=seeds)
def test_the_slow_part_solves_its_equations(seed):
    noise = np.random.default_rng(seed).normal(size=50)
    w = 1.0 / (2.0 * np.pi * 1.0 * 0.01) ** 2
    difference = np.diff(np.eye(50), axis=0)
    expected = np.linalg.solve(np.eye(50) + w * difference.T @ difference, noise)
    assert np.allclose(slow_part(noise, crossover_hz=1.0), expected, atol=1e-9)


def by_elimination(values, *, crossover_hz):
    """Return the slow part by elimination, sample by sample, which is exact for any number of them."""
    n, w = len(values), 1.0 / (2.0 * np.pi * crossover_hz * 0.01) ** 2
    diagonal = np.full(n, 1.0 + 2.0 * w)
    diagonal[[0, -1]] = 1.0 + w
    bands = np.vstack([np.full(n, -w), diagonal, np.full(n, -w)])
    return linalg.solve_banded((1, 1), bands, values)


@given(seed=seeds, count=st.integers(2, 700), crossover_hz=st.sampled_from([0.01, 0.1, 1.0, 10.0]))
def test_the_slow_part_is_that_of_elimination_for_any_number_of_samples(seed, count, crossover_hz):
    walk = np.random.default_rng(seed).normal(size=count).cumsum()
    expected = by_elimination(walk, crossover_hz=crossover_hz)
    assert np.allclose(slow_part(walk, crossover_hz=crossover_hz), expected, atol=1e-8)


def test_the_slow_part_of_ten_minutes_is_as_exact():
    walk = np.random.default_rng(2).normal(size=60_000).cumsum()
    assert np.allclose(slow_part(walk, crossover_hz=0.1), by_elimination(walk, crossover_hz=0.1), atol=1e-7)


def test_a_nan_leaves_no_slow_part():
    holed = np.zeros(100)
    holed[50] = np.nan
    assert np.isnan(slow_part(holed, crossover_hz=0.1)).all()


@given(seed=seeds, count=st.integers(2, 300))
def test_the_derivative_is_that_of_numpy(seed, count):
    noise = np.random.default_rng(seed).normal(size=count)
    assert np.allclose(rate_of_change(noise), np.gradient(noise, 0.01), rtol=1e-12, atol=1e-12)


def test_derivative_and_integral_of_a_parabola():
    time = clock_s(300)
    assert np.allclose(rate_of_change(time**2)[1:-1], 2.0 * time[1:-1])
    assert np.allclose(integral(2.0 * time), time**2)
