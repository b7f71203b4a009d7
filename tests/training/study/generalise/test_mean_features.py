from __future__ import annotations

import numpy as np
import pytest

from tests.training.study.generalise.road_drives import FEW
from training.study.generalise.mean_features import learned_for_windows, smoothed_features


def roads_of(rng, roads_count, per_road_count, *, noise):
    road = np.repeat(np.arange(roads_count), per_road_count)
    label_mu = rng.uniform(0.2, 0.7, len(road))
    clean = np.column_stack([np.log(label_mu), np.log(label_mu) ** 2 + road])
    return [f"road-{i}" for i in road], label_mu, clean, clean + noise * rng.standard_normal(clean.shape)


def test_parabolas_stay_and_noise_goes(rng):
    roads, label_mu, clean, noisy = roads_of(rng, 30, 11, noise=0.1)
    assert smoothed_features(clean, label_mu=label_mu, roads=roads) == pytest.approx(clean)
    smoothed = smoothed_features(noisy, label_mu=label_mu, roads=roads)
    assert np.std(smoothed - clean) < 0.6 * np.std(noisy - clean)


def test_a_wild_drive_bends_no_parabola_out_of_the_range_of_its_road(rng):
    roads, label_mu, clean, _ = roads_of(rng, 1, 11, noise=0.0)
    wild = clean.copy()
    wild[5] *= 30.0
    smoothed = smoothed_features(wild, label_mu=label_mu, roads=roads)
    assert (smoothed >= wild.min(axis=0)).all()
    assert (smoothed <= wild.max(axis=0)).all()


def test_roads_with_few_drives_are_left_out(rng):
    roads, label_mu, clean, _ = roads_of(rng, 2, 6, noise=0.0)
    assert np.isnan(smoothed_features(clean, label_mu=label_mu, roads=roads)).all()


def test_mean_features_of_many_are_read_better_than_one(rng):
    roads, label_mu, _, noisy = roads_of(rng, 60, 11, noise=0.15)
    estimate_mu = learned_for_windows(FEW, noisy[:, :1], label_mu=label_mu, roads=roads)
    windows = np.log(0.4) + 0.15 * rng.standard_normal((200, 50, 1))
    many, one = estimate_mu(windows.mean(axis=1)), estimate_mu(windows[:, 0])
    assert np.abs(many - 0.4).mean() < 0.5 * np.abs(one - 0.4).mean()
