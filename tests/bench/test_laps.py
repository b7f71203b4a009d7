"""Where on a lap a car is, and the bank that its other laps tell."""

import numpy as np

from bench.onboard.laps import Laps, bank_of_other_laps_rad, laps_of, repeats_correlation
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S

LAP_M = 2400.0
SPEED_MPS = 30.0


def _driven_m(laps_count: float):
    return SPEED_MPS * SAMPLE_S * np.arange(int(laps_count * LAP_M / SPEED_MPS / SAMPLE_S))


def _bend_1pm(station_m):
    # Never alike at two places of a lap, and bending everywhere.
    turns = 2.0 * np.pi * station_m / LAP_M
    return 0.01 * (np.sin(3.0 * turns) + 0.7 * np.sin(7.0 * turns + 1.0) + 0.5 * np.sin(13.0 * turns + 2.0))


def test_a_lap_is_found_by_its_bends():
    driven_m = _driven_m(3.4)
    speed = np.full_like(driven_m, SPEED_MPS)
    laps = laps_of(speed, SPEED_MPS * _bend_1pm(driven_m))
    assert abs(laps.lap_m - LAP_M) <= 2.0
    assert abs(laps.laps_count - 3.4) < 0.01
    away_m = np.abs((laps.station_m - driven_m + LAP_M / 2.0) % LAP_M - LAP_M / 2.0)
    assert away_m.max() < 10.0


def test_the_bank_of_other_laps_is_theirs_and_not_the_own():
    driven_m = _driven_m(3.0)
    laps = Laps(LAP_M, (driven_m / LAP_M).astype(int), np.mod(driven_m, LAP_M))
    bank = 0.03 * np.sin(2.0 * np.pi * laps.station_m / LAP_M)
    gravity = GRAVITY_MPS2 * np.sin(bank)
    assert np.abs(bank_of_other_laps_rad(gravity, laps) - bank).max() < 0.001
    # A lie in one lap changes what is said of the others, and nothing that is said of that lap.
    middle = laps.lap_number == 1
    well_inside = middle & (laps.station_m > 200.0) & (laps.station_m < LAP_M - 200.0)
    lying = bank_of_other_laps_rad(gravity + np.where(middle, 1.0, 0.0), laps)
    assert np.abs(lying - bank)[well_inside].max() < 0.001
    assert np.abs(lying - bank)[laps.lap_number == 0].mean() > 0.02


def test_what_repeats_each_lap_correlates_and_what_does_not_does_not():
    driven_m = _driven_m(4.0)
    laps = Laps(LAP_M, (driven_m / LAP_M).astype(int), np.mod(driven_m, LAP_M))
    speed = np.full_like(driven_m, SPEED_MPS)
    assert repeats_correlation(np.sin(2.0 * np.pi * laps.station_m / LAP_M), laps, speed) > 0.999
    noise = np.random.default_rng(3).standard_normal(len(driven_m))
    assert abs(repeats_correlation(noise, laps, speed)) < 0.15
