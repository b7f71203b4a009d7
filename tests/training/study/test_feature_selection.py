from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.training.study.desk import Desk
from training.study.feature_selection import Selected, forward_selection, selected_features, selection
from vehicle_client.simulator.plan import SensorGrade


@given(st.lists(st.integers(-50, 50), min_size=1, max_size=8, unique=True), st.integers(1, 8))
def test_what_helps_each_for_itself_is_chosen_from_best_to_worst(worth, most_count):
    chosen, found = forward_selection(
        lambda columns: -sum(worth[column] for column in columns), len(worth), most_count=most_count
    )
    assert list(chosen) == sorted(range(len(worth)), key=lambda column: -worth[column])[:most_count]
    assert found == pytest.approx(-np.cumsum(sorted(worth, reverse=True)[:most_count]))


def test_a_pair_that_only_helps_together_is_not_seen_by_a_greedy_search():
    def score(columns):
        return 0.0 if {0, 1} <= set(columns) else 0.9 if 2 in columns else 1.0

    assert forward_selection(score, 4, most_count=3)[0] == (2, 0, 1)
    assert forward_selection(score, 4, most_count=1)[0] == (2,)


def test_of_equals_the_first_is_chosen():
    assert forward_selection(lambda columns: 1.0, 5, most_count=3)[0] == (0, 1, 2)


def test_every_set_is_asked_for_in_ascending_order_and_once():
    asked = []

    def score(columns):
        asked.append(columns)
        return float(-columns[-1])

    forward_selection(score, 6, most_count=4)
    assert len(asked) == len(set(asked)) == 6 + 5 + 4 + 3
    assert all(list(columns) == sorted(columns) for columns in asked)


def test_the_two_features_that_friction_follows_from_are_found_first():
    chosen = selection(Desk(), SensorGrade.IDEAL, most_count=3)
    # tests.training.runs: friction follows from columns 0 and 44.
    assert set(chosen.names[:2]) == {"steer_mean_rad", "speed_mean_mps"}
    assert chosen.mape_ratio[1] < chosen.mape_ratio[0]


def test_the_search_is_made_once_and_cut_where_asked():
    desk = Desk()
    candidates = ("steer_mean_rad", "steer_std_rad", "speed_mean_mps", "speed_std_mps")
    whole = selection(desk, SensorGrade.IDEAL, candidates)
    assert isinstance(whole, Selected)
    assert selected_features(desk, SensorGrade.IDEAL, count=2, candidates=candidates) == whole.names[:2]
    assert len(desk.worked) == 1
    with pytest.raises(ValueError, match="ends at 4"):
        selected_features(desk, SensorGrade.IDEAL, candidates=candidates)
