"""Envelopes: they know what they were shown, flag what is far from it, and keep the share of false flags asked for."""

import numpy as np
import pytest

from rsu_app.domain.envelope import is_strange_driving, is_strange_road, outside_box
from training.study import envelopes
from training.study.envelopes import (
    UNSEEN_FLAGGED_FRAC,
    Ordinary,
    learn_driving_envelope,
    learn_road_box,
    learn_whole_envelope,
)

NAMES = ("speed", "steer", "yaw", "road_a", "road_b")
DRIVING, ROAD = NAMES[:3], NAMES[3:]


def rows_of(rng: np.random.Generator, count: int, *, road: np.ndarray | None = None) -> np.ndarray:
    speed, steer = rng.normal(15.0, 3.0, count), rng.normal(0.0, 0.05, count)
    yaw = speed * steer / 3.0 + rng.normal(0.0, 0.02, count)
    map_features = np.tile([1.0, 0.0], (count, 1)) if road is None else road
    return np.column_stack([speed, steer, yaw, map_features])


@pytest.fixture(scope="module")
def drives() -> Ordinary:
    rng = np.random.default_rng(1)
    roads = rng.uniform(-2.0, 2.0, (80, 2))
    number = np.repeat(np.arange(80), 10)
    return Ordinary(
        known_rows=rows_of(rng, 600),
        unseen_rows=rows_of(rng, 800, road=roads[number]),
        unseen_road=tuple(f"road-{i}" for i in number),
        feature_names=NAMES,
    )


def test_ordinary_driving_on_a_new_road_is_seldom_strange(drives: Ordinary):
    whole = learn_whole_envelope(drives, road_columns=ROAD, driving_columns=DRIVING, seed=1)
    rng = np.random.default_rng(2)
    fresh = rows_of(rng, 4000, road=rng.uniform(-2.0, 2.0, (4000, 2)))
    assert is_strange_driving(fresh, whole, NAMES).mean() < 2.0 * UNSEEN_FLAGGED_FRAC
    assert is_strange_road(fresh, whole, NAMES).mean() < 0.05


def test_a_combination_no_driver_has_is_strange_though_each_feature_is_usual(drives: Ordinary):
    whole = learn_whole_envelope(drives, road_columns=ROAD, driving_columns=DRIVING, seed=1)
    steering_without_yaw = np.array([[16.0, 0.09, -0.4, 1.0, 0.0]])
    assert is_strange_driving(steering_without_yaw, whole, NAMES).all()
    assert not is_strange_road(steering_without_yaw, whole, NAMES).any()


def test_a_road_unlike_all_others_is_strange_however_it_is_driven(drives: Ordinary):
    whole = learn_whole_envelope(drives, road_columns=ROAD, driving_columns=DRIVING, seed=1)
    usual = rows_of(np.random.default_rng(3), 200, road=np.tile([9.0, 9.0], (200, 1)))
    assert is_strange_road(usual, whole, NAMES).all()
    assert is_strange_driving(usual, whole, NAMES).mean() < 0.1


def test_the_same_drives_give_the_same_envelope(drives: Ordinary):
    one, other = (learn_driving_envelope(drives.columns(DRIVING), seed=4) for _ in range(2))
    assert one == other


def test_many_rows_are_thinned(drives: Ordinary, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(envelopes, "MOST_ROWS_COUNT", 200)
    envelope = learn_driving_envelope(drives.columns(DRIVING), seed=1)
    assert len(envelope.share_frac) == envelopes.KINDS_COUNT


def test_known_roads_are_never_strange():
    rng = np.random.default_rng(5)
    known, random = rng.normal(0.0, 3.0, (3, 4)), rng.normal(0.0, 1.0, (40, 4))
    box = learn_road_box(known, random, seed=1)
    assert not outside_box(known, box).any()
    assert not outside_box(known.astype(np.float32).astype(np.float64), box).any()


def test_a_box_counts_what_lies_outside():
    box = learn_road_box(np.zeros((1, 3)), np.tile(np.linspace(-1.0, 1.0, 9)[:, None], 3), seed=1)
    far = np.array([[5.0] * k + [0.0] * (3 - k) for k in range(4)])
    assert outside_box(far, box).tolist() == [k > box.outside_allowed_count for k in range(4)]
