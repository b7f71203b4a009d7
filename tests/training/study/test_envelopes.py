"""Envelopes: they know what they were shown, flag what is far from it, and keep the share of false flags asked for."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from roadgrip.envelope import DrivingEnvelope
from roadgrip.features import GRIP_TABLE, PAPER_TABLE
from rsu_app.domain.envelope import (
    is_strange,
    is_strange_driving,
    is_strange_road,
    outside_box,
    prepared,
    strangeness_level,
)
from training.study import envelopes
from training.study.envelopes import (
    UNSEEN_FLAGGED_FRAC,
    Ordinary,
    driving_columns,
    learn_driving_envelope,
    learn_road_box,
    learn_whole_envelope,
)
from training.study.mirror import mirror_of

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


LEFT_AND_RIGHT = ("steer_mean_rad", "steer_min_rad", "steer_max_rad", "speed_mean_mps")


def bends_of(rng: np.random.Generator, count: int, *, side: float) -> np.ndarray:
    """Return drives through bends to one side."""
    mean, width = side * rng.uniform(0.02, 0.1, count), rng.uniform(0.01, 0.03, count)
    return np.column_stack([mean, mean - width, mean + width, 20.0 - 80.0 * np.abs(mean)])


def test_who_only_knows_left_bends_knows_right_ones():
    rng = np.random.default_rng(7)
    roads = tuple(f"road-{i % 40}" for i in range(600))
    left = Ordinary(bends_of(rng, 600, side=1.0), bends_of(rng, 600, side=1.0), roads, LEFT_AND_RIGHT)
    ready = prepared(learn_driving_envelope(left, seed=1), LEFT_AND_RIGHT)
    rows = bends_of(rng, 300, side=1.0)
    mirrored = mirror_of(LEFT_AND_RIGHT).of(rows)
    assert strangeness_level(mirrored, ready) == pytest.approx(strangeness_level(rows, ready), abs=1e-3)
    assert is_strange(bends_of(rng, 300, side=-1.0), ready).mean() < 0.1


def test_more_is_asked_of_the_road_and_nothing_else_the_stranger_the_drive():
    rng = np.random.default_rng(8)
    names = ("steer_mean_rad", "demand_q100_mu")
    asked = rng.uniform(0.1, 0.4, 1200)
    rows = np.column_stack([asked * rng.choice([-0.2, 0.2], 1200), asked])
    drives = Ordinary(rows[:600], rows[600:], tuple(f"road-{i % 40}" for i in range(600)), names)
    ready = prepared(learn_driving_envelope(drives, seed=1), names)
    level = strangeness_level(np.column_stack([np.full(20, 0.08), np.linspace(0.45, 1.2, 20)]), ready)
    assert (np.diff(level) >= -1e-9).all()
    assert level[0] > ready.limit_level


def test_an_envelope_of_either_table_goes_through_a_manifest():
    for table in (PAPER_TABLE, GRIP_TABLE):
        names = driving_columns(table)
        assert set(names) <= set(table.names)
        rng = np.random.default_rng(9)
        rows = rng.normal(0.0, 1.0, (400, len(names)))
        drives = Ordinary(rows[:200], rows[200:], tuple(f"road-{i % 20}" for i in range(200)), names)
        envelope = learn_driving_envelope(drives, seed=1)
        assert DrivingEnvelope(**json.loads(json.dumps(asdict(envelope), default=np.ndarray.tolist))) is not None


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
