"""Figures of an estimate against a truth that is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench.onboard.agreement import agreement, gain_by_frequency, pooled

TIME_S = 0.01 * np.arange(2000)
CURVE = np.sin(2.0 * np.pi * 0.5 * TIME_S)
signals = arrays(np.float64, 50, elements=st.floats(-10.0, 10.0))


def test_a_perfect_estimate_has_no_error_and_full_correlation():
    found = pooled([agreement(CURVE, CURVE)] * 3, unit="rad")
    assert found["rms_error_rad"] == 0.0
    assert found["correlation_ratio"] == pytest.approx(1.0)
    assert found["seen_of_peak_q50_ratio"] == 1.0


def test_claiming_zero_has_the_truth_for_error():
    found = pooled([agreement(np.zeros_like(CURVE), CURVE)], unit="rad")
    assert found["rms_error_rad"] == found["rms_truth_rad"] == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert found["correlation_ratio"] == 0.0
    assert found["seen_of_peak_q50_ratio"] == 0.0


def test_a_constant_error_is_bias_and_leaves_the_correlation():
    found = pooled([agreement(CURVE + 0.25, CURVE)], unit="rad")
    assert found["bias_rad"] == pytest.approx(0.25)
    assert found["largest_error_largest_rad"] == pytest.approx(0.25)
    assert found["correlation_ratio"] == pytest.approx(1.0)


def test_half_of_the_signal_is_half_of_its_peak():
    found = pooled([agreement(0.5 * CURVE, CURVE), agreement(0.5 * CURVE, CURVE)], unit="rad")
    assert found["seen_of_peak_q50_ratio"] == pytest.approx(0.5)
    assert found["rms_error_standard_error_rad"] == 0.0


def test_long_and_short_drives_weigh_the_same():
    good, bad = agreement(CURVE, CURVE), agreement(np.ones(10), np.zeros(10))
    assert pooled([good, bad], unit="rad")["rms_error_rad"] == pytest.approx(np.sqrt(0.5))


def test_the_standard_error_is_that_of_many_repetitions():
    rng = np.random.default_rng(5)
    cells = [
        pooled([agreement(np.full(4, scale), np.zeros(4)) for scale in rng.uniform(0.5, 1.5, 40)], unit="rad")
        for _ in range(300)
    ]
    spread = np.std([cell["rms_error_rad"] for cell in cells])
    assert np.mean([cell["rms_error_standard_error_rad"] for cell in cells]) == pytest.approx(spread, rel=0.15)


@given(signals, signals)
def test_the_mirrored_drive_agrees_as_well(estimate, truth):
    there, mirrored = (pooled([agreement(s * estimate, s * truth)], unit="rad") for s in (1.0, -1.0))
    assert mirrored["rms_error_rad"] == there["rms_error_rad"]
    assert mirrored["bias_rad"] == -there["bias_rad"]
    assert mirrored["seen_of_peak_q50_ratio"] == there["seen_of_peak_q50_ratio"]


def test_the_gain_shows_which_frequencies_are_seen():
    slow = np.sin(2.0 * np.pi * 0.1 * TIME_S)
    found = gain_by_frequency([(CURVE + 0.2 * slow, CURVE + slow)] * 4, edges_hz=(0.05, 0.2, 1.0))
    assert found["gain_ratio"] == pytest.approx([0.2, 1.0], abs=0.03)
    assert found["coherence_ratio"] == pytest.approx([1.0, 1.0], abs=0.05)


def test_what_lags_a_quarter_turn_has_no_gain_but_coherence():
    found = gain_by_frequency([(np.cos(2.0 * np.pi * 0.5 * TIME_S), CURVE)], edges_hz=(0.2, 1.0))
    assert found["gain_ratio"] == pytest.approx([0.0], abs=0.02)
    assert found["coherence_ratio"] == pytest.approx([1.0], abs=0.02)
