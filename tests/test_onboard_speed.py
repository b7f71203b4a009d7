"""What is told about the client's speed: the page has the figures that are kept, and what is compared is the same."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.onboard_speed import TOLERANCE_RATIO, difference_ratio, page_with_tables
from bench.speed import float_loop, with_scipy
from bench.speed.steps import Steps
from tests.vehicle_client.synthetic import drive_over, road, s_turn, with_noise
from vehicle_client.estimation.offsets import NO_OFFSETS


@pytest.fixture(scope="module")
def figures(project_root):
    kept = project_root / "docs" / "results" / "onboard" / "speed.json"
    return json.loads(kept.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def steps():
    """A drive of which every step has something to do: offsets, a bank, a wheel that spins up and one that hangs."""
    trace, station_m = drive_over(s_turn, swing_mps=3.0)
    trace = with_noise(trace, np.random.default_rng(8))
    trace.wheel_speed_mps[900:1000, 2] += np.linspace(0.0, 6.0, 100)
    trace.wheel_speed_mps[1500:1600, 1] = 3.0
    return Steps(
        trace=trace,
        section=road(s_turn, cross_slope_ratio=0.04),
        station_m=station_m,
        inside=(station_m >= 0.0) & (station_m < 400.0),
        offsets=replace(NO_OFFSETS, yaw_rate_radps=0.003, accel_x_mps2=0.05, accel_y_mps2=0.1, steer_rad=0.004),
    )


def test_the_page_has_the_figures_that_are_kept(project_root, figures):
    page = (project_root / "docs" / "vehicle.md").read_text(encoding="utf-8")
    assert page == page_with_tables(page, figures)


def test_what_is_kept_is_within_what_a_car_can_give(figures):
    assert figures["passage_40s_ms"] <= 15.0
    assert figures["extra_memory_mb"] <= 60.0
    assert figures["vehicle_install_mb"] < 150.0


def test_what_is_told_is_the_dearest_passage_and_the_least_favourable_road(figures):
    assert figures["passage_40s_ms"] == max(row["whole_ms"] for row in figures["passages"])
    for ratio in ("times_float_loop", "times_scipy"):
        assert figures[ratio] == min(row[ratio] for row in figures["comparison"])
    assert all(row["difference_ratio"] <= TOLERANCE_RATIO for row in figures["comparison"])


def test_a_loop_over_samples_gives_the_same_features(steps):
    values = np.array(float_loop.values(float_loop.recorded(steps), steps))
    assert difference_ratio(values, steps) <= TOLERANCE_RATIO


def test_scipy_gives_the_same_features(steps):
    assert difference_ratio(with_scipy.values(steps), steps) <= TOLERANCE_RATIO


def test_another_constant_gives_other_features(steps):
    doubled = 2.0 * steps.parameters.roll_crossover_hz
    other = replace(steps, parameters=replace(steps.parameters, roll_crossover_hz=doubled))
    assert difference_ratio(with_scipy.values(other), steps) > 1e3 * TOLERANCE_RATIO
