"""Laws of the time step: a finer one changes what is learnt from a drive by less than a stated bound."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.vehicle_client.simulator.rig import curvy_road
from vehicle_client.simulator.plan import ALL_SYSTEMS
from vehicle_client.simulator.proving_ground import Plane, drive_open_loop
from vehicle_client.simulator.run import SensorGrade, draw_plan, simulate_passage

pytestmark = pytest.mark.sim

ROADS = (
    curvy_road(),
    curvy_road(radius_m=100.0, speed_mps=22.0, bank_ratio=0.04),
    curvy_road(radius_m=35.0, speed_mps=13.0, mirrored=True),
)
SIGNALS = ("steer_rad", "sideslip_rad", "velocity_x_mps", "yaw_rate_radps")
STEPS_S = (0.002, 0.001, 0.0005)


def statistics(drive):
    """Return mean, deviation, quantiles and extremes of each signal over its largest magnitude. (4, 9)"""
    inside = drive.truth.station_m >= 0.0
    rows = []
    for name in SIGNALS:
        values = getattr(drive.truth, name)[inside]
        quantiles = np.quantile(values, [0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0])
        rows.append(np.array([values.mean(), values.std(), *quantiles]) / np.abs(values).max())
    return np.array(rows)


@cache
def completed_drives():
    """Return statistics of drives that are completed with every step. (drives, steps, 4, 9)"""
    rng = np.random.default_rng(3)
    drives = []
    for road in ROADS:
        for mu in (0.3, 0.45, 0.6, 0.8):
            for _ in range(2):
                plan = replace(draw_plan(rng, section=road, base_friction_mu=mu), sensor_grade=SensorGrade.IDEAL)
                runs = [simulate_passage(road, plan, step_s=step) for step in STEPS_S]
                if all(run.completed for run in runs):
                    drives.append([statistics(run) for run in runs])
    return np.array(drives)


def test_a_step_decides_for_no_drive_how_it_ends():
    rng = np.random.default_rng(4)
    for road in ROADS:
        for mu in (0.25, 0.4, 0.7):
            plan = replace(draw_plan(rng, section=road, base_friction_mu=mu), sensor_grade=SensorGrade.IDEAL)
            assert len({simulate_passage(road, plan, step_s=step).outcome for step in STEPS_S}) == 1


def test_a_quarter_of_the_step_changes_a_typical_statistic_by_less_than_two_in_ten_thousand():
    drives = completed_drives()
    assert len(drives) >= 18
    assert np.median(np.abs(drives[:, 0] - drives[:, 2])) < 2e-4


def test_a_quarter_of_the_step_changes_hardly_a_drive_by_more_than_half_a_per_cent():
    worst = np.abs((drives := completed_drives())[:, 0] - drives[:, 2]).max(axis=(1, 2))
    assert np.median(worst) < 0.005


@pytest.mark.parametrize(("finer", "bound"), [(1, 0.008), (2, 0.01)])
def test_a_finer_step_changes_no_statistic_of_any_drive_by_more_than_a_stated_bound(finer, bound):
    drives = completed_drives()
    assert np.abs(drives[:, 0] - drives[:, finer]).max() < bound


@pytest.mark.parametrize("mu", [0.3, 0.8])
def test_without_driver_and_systems_the_error_falls_in_proportion_to_the_step(mu):
    # First order: with half the step half the error, against a step so small that it counts as none.
    steer = 0.05 * mu * np.sin(2.0 * 0.01 * np.arange(300))
    yaw = {
        step: drive_open_loop(Plane(mu), speed_mps=20.0, steer_rad=steer, step_s=step).yaw_rate_radps
        for step in (0.002, 0.001, 0.000125)
    }
    coarse, fine = (np.abs(yaw[step] - yaw[0.000125]).max() for step in (0.002, 0.001))
    assert coarse < 0.01 * np.abs(yaw[0.000125]).max()
    assert 1.6 < coarse / fine < 2.8


@pytest.mark.parametrize("mu", [0.2, 0.6])
def test_full_braking_with_the_systems_hardly_depends_on_the_step(mu):
    pedal = np.clip(0.01 * np.arange(250) / 0.3, 0.0, 1.0) * -11.0
    ways = [
        drive_open_loop(
            Plane(mu), speed_mps=25.0, steer_rad=np.zeros(250), accel_mps2=pedal, systems=ALL_SYSTEMS, step_s=step
        ).velocity_x_mps.sum()
        for step in STEPS_S
    ]
    assert np.ptp(ways) < 0.005 * ways[0]
