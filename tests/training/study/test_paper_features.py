from __future__ import annotations

import pytest

from training.study.paper_features import (
    KINEMATIC_FEATURES,
    PAPER_FEATURES,
    SPEED_FEATURES,
    of_statistics,
    signal_of,
    statistic_of,
    without_signals,
)


def test_the_paper_has_five_signals_two_profiles_and_a_length():
    assert len(PAPER_FEATURES) == 5 * 11 + 2 * 11 + 1
    assert len(KINEMATIC_FEATURES) == 55
    assert len(SPEED_FEATURES) == 11


@pytest.mark.parametrize(
    ("name", "signal", "statistic"),
    [
        ("yaw_rate_excess_q80_radps", "yaw_rate_excess", "q80"),
        ("sideslip_rate_min_radps", "sideslip_rate", "min"),
        ("sideslip_median_rad", "sideslip", "median"),
        ("steer_skewness", "steer", "skewness"),
        ("road_difficulty_mean_ratio", "road_difficulty", "mean"),
        ("section_length_m", "section_length_m", ""),
    ],
)
def test_a_name_tells_signal_and_statistic(name, signal, statistic):
    assert name in PAPER_FEATURES
    assert (signal_of(name), statistic_of(name)) == (signal, statistic)


def test_leaving_out_the_sideslip_keeps_its_rate_unless_that_is_named_too():
    kept = without_signals(PAPER_FEATURES, {"sideslip"})
    assert len(kept) == 67
    assert {signal_of(name) for name in kept} >= {"sideslip_rate"}


def test_mean_and_std_are_two_of_every_signal():
    assert len(of_statistics(PAPER_FEATURES, ("mean", "std"))) == 14
