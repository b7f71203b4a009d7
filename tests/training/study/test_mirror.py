"""Mirror images of drives: twice is once around, and no statistic contradicts another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from roadgrip.features import GRIP_TABLE, PAPER_TABLE, STATISTICS, statistics_of
from training.study.envelopes import driving_columns
from training.study.mirror import mirror_of

STEER = tuple(feature.name for feature in PAPER_TABLE.kinematic if feature.name.startswith("steer_"))


@given(arrays(np.float64, 40, elements=st.floats(-1.0, 1.0)))
def test_the_mirror_of_the_statistics_is_the_statistics_of_the_mirrored_signal(samples):
    mirrored = mirror_of(STEER).of(statistics_of(samples)[None, :])[0]
    there = dict(zip(STATISTICS, statistics_of(-samples), strict=True))
    assert mirrored == pytest.approx(list(there.values()), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("table", [PAPER_TABLE, GRIP_TABLE])
def test_twice_is_once_around_and_one_side_is_one_side(table):
    names = driving_columns(table)
    mirror, rows = mirror_of(names), np.random.default_rng(1).normal(size=(30, len(names)))
    assert (mirror.of(mirror.of(rows)) == rows).all()
    sided = mirror.to_one_side(rows)
    assert (sided == mirror.to_one_side(mirror.of(rows))).all()
    assert ((sided == rows).all(axis=1) | (sided == mirror.of(rows)).all(axis=1)).all()


def test_speed_and_magnitudes_have_no_side():
    names = driving_columns(GRIP_TABLE)
    mirror = mirror_of(names)
    even = [name for i, name in enumerate(names) if mirror.partner[i] == i and mirror.sign_ratio[i] > 0.0]
    assert {name for name in names if name.startswith(("speed_", "demand_", "force_", "yaw_rate_max_"))} <= set(even)


def test_a_statistic_without_its_counterpart_has_no_mirror():
    with pytest.raises(ValueError, match="steer_q20_rad"):
        mirror_of(("steer_mean_rad", "steer_q20_rad"))
