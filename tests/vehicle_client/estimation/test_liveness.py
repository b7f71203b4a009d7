"""Sensors that do not live."""

import numpy as np
import pytest

from vehicle_client.estimation.liveness import clipped_s, frozen_rows, rests

N = 1000


def noise(seed):
    return np.random.default_rng(seed).normal(0.0, 0.01, N)


def borders(**channels):
    valid = np.ones(N, dtype=bool)
    return {name: rests(values, valid) for name, values in channels.items()}


def frozen(values, *, from_row=400, to_row=N):
    values = values.copy()
    values[from_row:to_row] = values[from_row]
    return values


def test_rests_end_where_the_value_changes_or_a_sample_is_missing():
    values = np.array([1.0, 1.0, 2.0, 2.0, 2.0, 3.0])
    assert rests(values, np.ones(6, dtype=bool)).tolist() == [0, 2, 5, 6]
    valid = np.array([True, True, True, False, True, True])
    assert rests(values, valid).tolist() == [0, 2, 3, 4, 5, 6]


def test_a_channel_that_stops_while_others_live_is_frozen():
    found = frozen_rows(borders(a=frozen(noise(1)), b=noise(2), c=noise(3)), "a")
    assert found == slice(400, N)


def test_a_channel_that_never_lived_is_frozen_too():
    assert frozen_rows(borders(a=np.ones(N), b=noise(2), c=noise(3)), "a") == slice(0, N)


def test_where_all_channels_rest_none_is_frozen():
    still = borders(a=frozen(noise(1)), b=frozen(noise(2)), c=frozen(noise(3)))
    assert all(frozen_rows(still, name) is None for name in still)


def test_one_other_that_lives_is_no_proof():
    assert frozen_rows(borders(a=frozen(noise(1)), b=noise(2), c=frozen(noise(3))), "a") is None


def test_a_coarse_channel_that_often_rests_is_not_frozen():
    coarse = np.repeat(np.arange(10.0), 100)
    assert frozen_rows(borders(a=coarse, b=noise(2), c=noise(3)), "a") is None


def test_the_end_of_a_range_is_seen_where_a_channel_stays_there():
    wave = 10.0 * np.sin(np.arange(N) / 50.0)
    cut = np.clip(wave, -8.0, 8.0)
    valid = np.ones(N, dtype=bool)
    expected = float(np.sum(np.abs(cut) == 8.0)) * 0.01
    assert clipped_s(cut, rests(cut, valid), least_value=5.0) == expected > 1.0
    assert clipped_s(cut, rests(cut, valid), least_value=9.0) == 0.0
    assert clipped_s(wave, rests(wave, valid), least_value=5.0) == 0.0


@pytest.mark.parametrize(("rested_count", "found"), [(100, True), (130, False)])
def test_a_rest_is_a_freeze_from_four_times_as_long_as_any_other(rested_count, found):
    values = noise(1)
    values[100 : 100 + rested_count] = 0.5
    values[500:] = 0.7
    assert (frozen_rows(borders(a=values, b=noise(2), c=noise(3)), "a") is not None) is found


def test_a_channel_is_at_the_end_of_its_range_from_three_samples_on():
    for count, expected in ((2, 0.0), (3, 0.03)):
        values = noise(1)
        values[200 : 200 + count] = 8.0
        assert clipped_s(values, rests(values, np.ones(N, dtype=bool)), least_value=5.0) == pytest.approx(expected)
