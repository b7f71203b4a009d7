import numpy as np
import pytest
from scipy import signal

from vehicle_client.simulator.surface import CLASS_A_DENSITY_M3, GRID_M, roughness_m

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def spectra():
    tracks = roughness_m(np.random.default_rng(5), length_m=60_000.0)
    rate = 1.0 / GRID_M
    n, left = signal.welch(tracks[:, 0], fs=rate, nperseg=4096)
    _, right = signal.welch(tracks[:, 1], fs=rate, nperseg=4096)
    _, coherence = signal.coherence(tracks[:, 0], tracks[:, 1], fs=rate, nperseg=4096)
    return n, left, right, coherence


def test_both_tracks_have_the_spectrum_of_class_a(spectra):
    n, left, right, _ = spectra
    band = (n > 0.03) & (n < 2.0)
    asked = CLASS_A_DENSITY_M3 * (n[band] / 0.1) ** -2
    for track in (left, right):
        ratio = track[band] / asked
        # Class limits are half and twice the middle; a mean over decades must be far closer.
        assert abs(np.exp(np.log(ratio).mean()) - 1.0) < 0.1
        assert np.mean((ratio > 0.5) & (ratio < 2.0)) > 0.98


def test_long_waves_lift_both_tracks_and_short_ones_each_alone(spectra):
    n, _, _, coherence = spectra
    assert coherence[(n > 0.01) & (n < 0.03)].mean() > 0.9
    assert coherence[n > 1.0].mean() < 0.05


def test_the_same_chance_gives_the_same_surface():
    one, two = (roughness_m(np.random.default_rng(1), length_m=50.0) for _ in range(2))
    assert np.array_equal(one, two)
