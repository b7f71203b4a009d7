"""The road surface against ISO 8608 and against an isotropic plane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal, special

from vehicle_client.simulator.plan import RoughnessClass
from vehicle_client.simulator.surface import (
    CLASS_A_DENSITY_M3,
    GRID_M,
    HIGHEST_WAVE_NUMBER_1PM,
    LOWEST_WAVE_NUMBER_1PM,
    TRACK_M,
    class_density_m3,
    isotropic_coherence_ratio,
    roughness_m,
)

LENGTH_M = 900.0
"""Of a usual road with approach and exit."""
OCTAVES_1PM = LOWEST_WAVE_NUMBER_1PM * 2.0 ** np.arange(1, 8)
"""Lower ends of whole octaves of the standard's range; Welch's windows are too short for the first."""


def surfaces(roughness: RoughnessClass, *, draws_count: int = 60) -> np.ndarray:
    """Many surfaces of one class. (draws, n, 2)"""
    rng = np.random.default_rng(5)
    density_m3 = class_density_m3(roughness)
    return np.stack([roughness_m(rng, length_m=LENGTH_M, density_m3=density_m3) for _ in range(draws_count)])


def spectra(tracks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Wave numbers, spectra of left and right, and their cross spectrum, each the mean over the draws."""
    left, right = tracks[..., 0], tracks[..., 1]
    n, left_m3 = signal.welch(left, fs=1.0 / GRID_M, nperseg=4096)
    _, right_m3 = signal.welch(right, fs=1.0 / GRID_M, nperseg=4096)
    _, cross_m3 = signal.csd(left, right, fs=1.0 / GRID_M, nperseg=4096)
    return n, left_m3.mean(0), right_m3.mean(0), cross_m3.mean(0)


def octave_means(n: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.array([values[(n >= low) & (n < min(2.0 * low, HIGHEST_WAVE_NUMBER_1PM))].mean() for low in OCTAVES_1PM])


def iso_m3(n: np.ndarray, density_m3: float = CLASS_A_DENSITY_M3) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return density_m3 * (n / 0.1) ** -2.0


@pytest.fixture(scope="module")
def class_a() -> np.ndarray:
    return surfaces(RoughnessClass.A)


# The geometric means of ISO 8608, table C.2, in 1e-6 m3.
@pytest.mark.parametrize(("roughness", "middle"), list(zip(RoughnessClass, (16, 64, 256, 1024, 4096), strict=True)))
def test_every_class_has_its_spectrum_in_every_octave(roughness: RoughnessClass, middle: float):
    n, left_m3, right_m3, _ = spectra(surfaces(roughness))
    for track_m3 in (left_m3, right_m3):
        ratio = octave_means(n, track_m3) / octave_means(n, iso_m3(n, 1e-6 * middle))
        # The class reaches from half to twice its middle; a mean over 60 roads is far closer.
        assert ratio == pytest.approx(1.0, abs=0.15)


def test_single_roads_lie_in_their_class_where_waves_are_many(class_a: np.ndarray):
    n, one_m3 = signal.welch(class_a[:, :, 0], fs=1.0 / GRID_M, nperseg=2048)
    for low in OCTAVES_1PM[2:]:
        band = (n >= low) & (n < min(2.0 * low, HIGHEST_WAVE_NUMBER_1PM))
        ratio = one_m3[:, band].mean(1) / iso_m3(n[band]).mean()
        assert np.all((ratio > 0.5) & (ratio < 2.0))


def test_the_spectrum_falls_with_the_square_of_the_wave_number(class_a: np.ndarray):
    n, left_m3, _, _ = spectra(class_a)
    band = (n > 2.0 * LOWEST_WAVE_NUMBER_1PM) & (n < HIGHEST_WAVE_NUMBER_1PM)
    slope = np.polyfit(np.log(n[band]), np.log(left_m3[band]), 1)[0]
    assert slope == pytest.approx(-2.0, abs=0.03)


def test_waves_that_belong_to_the_map_are_left_out(class_a: np.ndarray):
    # The variance is the area under the spectrum; with 500 m waves it would be five times as large.
    asked_m2 = CLASS_A_DENSITY_M3 * 0.01 * (1.0 / LOWEST_WAVE_NUMBER_1PM - 1.0 / HIGHEST_WAVE_NUMBER_1PM)
    assert np.var(class_a) == pytest.approx(asked_m2, rel=0.1)
    assert abs(class_a.mean()) < 0.1 * np.sqrt(asked_m2)


def test_from_class_to_class_heights_double():
    smooth, *rougher = [
        roughness_m(np.random.default_rng(3), length_m=200.0, density_m3=class_density_m3(r)) for r in RoughnessClass
    ]
    for number, rough in enumerate(rougher, start=1):
        assert rough == pytest.approx(2.0**number * smooth)


def test_the_coherence_is_that_of_an_isotropic_surface():
    n = np.geomspace(1e-6, 3.0, 300)
    z = 2.0 * np.pi * n * TRACK_M
    ratio = isotropic_coherence_ratio(n)
    assert ratio == pytest.approx(z * special.k1(z), abs=1e-12)
    assert np.all(np.diff(ratio) < 0.0)
    assert ratio[0] == pytest.approx(1.0, abs=1e-9)
    assert ratio[-1] < 1e-9


def test_on_an_isotropic_surface_a_wheel_track_is_as_far_as_the_slanted_line_is_long():
    """The closed form, against what isotropy says: variograms depend on the distance alone, whatever its direction."""
    n = np.geomspace(1e-6, 40.0, 60_000)
    for along_m in (0.0, 0.5, 2.0, 5.0):
        across = iso_m3(n) * (1.0 - isotropic_coherence_ratio(n) * np.cos(2.0 * np.pi * n * along_m))
        slanted_m = np.hypot(along_m, TRACK_M)
        straight = iso_m3(n) * (1.0 - np.cos(2.0 * np.pi * n * slanted_m))
        assert np.trapezoid(across, n) == pytest.approx(np.trapezoid(straight, n), rel=5e-3)


def test_both_tracks_share_long_waves_and_are_strangers_in_short_ones(class_a: np.ndarray):
    n, left_m3, right_m3, cross_m3 = spectra(class_a)
    together = octave_means(n, cross_m3.real) / np.sqrt(octave_means(n, left_m3) * octave_means(n, right_m3))
    asked = octave_means(n, iso_m3(n) * isotropic_coherence_ratio(np.maximum(n, 1e-3))) / octave_means(n, iso_m3(n))
    assert together == pytest.approx(asked, abs=0.06)
    assert together[0] > 0.85
    assert abs(together[-1]) < 0.02


def test_left_and_right_can_be_exchanged(class_a: np.ndarray):
    n, left_m3, right_m3, cross_m3 = spectra(class_a)
    assert octave_means(n, left_m3) == pytest.approx(octave_means(n, right_m3), rel=0.15)
    # Neither track runs ahead of the other: the cross spectrum is real.
    aside = octave_means(n, cross_m3.imag) / np.sqrt(octave_means(n, left_m3) * octave_means(n, right_m3))
    assert aside == pytest.approx(0.0, abs=0.06)


def test_a_surface_begins_as_it_goes_on_and_its_ends_do_not_meet():
    rng = np.random.default_rng(8)
    ends = np.array([roughness_m(rng, length_m=150.0)[[0, 700, -1], 0] for _ in range(1500)])
    spread = ends.std(axis=0)
    assert spread == pytest.approx(spread.mean(), rel=0.08)
    near = np.corrcoef(ends.T)
    assert abs(near[0, 2]) < 0.3


def test_read_by_straight_lines_it_is_what_a_contact_patch_of_14_cm_feels(class_a: np.ndarray):
    fine_m = 0.01
    station = np.arange(0.0, LENGTH_M, fine_m)
    read = np.array([np.interp(station, GRID_M * np.arange(len(one)), one[:, 0]) for one in class_a[:20]])
    n, felt_m3 = signal.welch(read, fs=1.0 / fine_m, nperseg=40_960)
    asked = iso_m3(n) * np.sinc(0.14 * n) ** 2
    ratio = octave_means(n, felt_m3.mean(0)) / octave_means(n, asked)
    assert ratio[2:] == pytest.approx(1.0, abs=0.1)


@given(seed=st.integers(0, 2**32), length_m=st.floats(0.0, 1500.0))
@settings(max_examples=40, deadline=None)
def test_the_same_chance_gives_the_same_surface_as_long_as_asked(seed: int, length_m: float):
    one, two = (roughness_m(np.random.default_rng(seed), length_m=length_m) for _ in range(2))
    assert np.array_equal(one, two)
    assert one.shape[1] == 2
    assert GRID_M * (len(one) - 1) >= length_m
    assert one.flags.c_contiguous
    assert np.isfinite(one).all()
