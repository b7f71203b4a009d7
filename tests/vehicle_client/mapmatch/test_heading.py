"""The gyro held to the map."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vehicle_client.synthetic import drive_over, road, s_turn
from vehicle_client.mapmatch.driven_line import driven_line
from vehicle_client.mapmatch.heading import heading_findings, heading_fit
from vehicle_client.mapmatch.match import MatchMethod, section_match

SECTION = road(s_turn)
TRACE, STATION = drive_over(s_turn)


def fit(*, gain=1.0, drift_radps=0.0, behind_m=0.0):
    line = driven_line(TRACE.wheel_speed_mps[:, 2:].mean(axis=1), gain * TRACE.yaw_rate_radps + drift_radps)
    match = section_match(
        TRACE.time_s,
        STATION - behind_m,
        length_m=400.0,
        confidence_frac=1.0,
        position_std_m=1.0,
        method=MatchMethod.GNSS,
    )
    return heading_fit(line, TRACE.time_s, match, SECTION)


def test_a_gyro_that_tells_the_truth_has_no_error():
    result = fit()
    assert abs(result.gain_error_ratio) < 0.01
    assert abs(result.shift_m) < 0.3
    assert result.rms_rad < 0.01
    assert not any(finding.doubtful for finding in heading_findings(result))


@pytest.mark.parametrize("gain", [0.0, 0.7, 1.3, -1.0])
def test_the_gain_of_the_gyro_is_found(gain):
    result = fit(gain=gain)
    assert result.gain_error_ratio == pytest.approx(gain - 1.0, rel=0.1)
    assert any(finding.doubtful for finding in heading_findings(result))


def test_a_drift_is_no_gain():
    assert abs(fit(drift_radps=0.003).gain_error_ratio) < 0.02


@pytest.mark.parametrize("behind_m", [-15.0, -5.0, 5.0, 15.0])
def test_a_match_that_lags_is_found_and_is_no_gain(behind_m):
    result = fit(behind_m=behind_m)
    assert result.shift_m == pytest.approx(behind_m, rel=0.15)
    assert abs(result.gain_error_ratio) < 0.05


def test_a_passage_of_a_second_says_nothing():
    match = section_match(
        TRACE.time_s, STATION, length_m=400.0, confidence_frac=1.0, position_std_m=1.0, method=MatchMethod.GNSS
    )
    line = driven_line(TRACE.wheel_speed_mps[:, 2], TRACE.yaw_rate_radps)
    assert heading_fit(line, TRACE.time_s, replace(match, exit_s=match.entry_s + 1.0), SECTION) is None
    assert heading_findings(None) == ()


def test_on_a_straight_the_gain_is_unknown():
    straight = road(np.zeros_like)
    trace, station = drive_over(np.zeros_like)
    match = section_match(
        trace.time_s, station, length_m=400.0, confidence_frac=1.0, position_std_m=1.0, method=MatchMethod.GNSS
    )
    result = heading_fit(driven_line(trace.wheel_speed_mps[:, 2], trace.yaw_rate_radps), trace.time_s, match, straight)
    assert result is not None
    assert result.gain_error_std_ratio > 0.25
    assert not any(finding.doubtful for finding in heading_findings(result))
