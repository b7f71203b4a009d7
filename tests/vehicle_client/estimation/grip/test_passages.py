"""Grip through the whole onboard client: mirrors, absent sensors, and simulated drives within the table's ranges."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import GRIP_TABLE
from tests.vehicle_client.estimation.grip.two_axles import NAMES, with_best_of_channels
from tests.vehicle_client.synthetic import drive_over, negative, road, s_turn, with_noise
from vehicle_client.estimation.grip.memory import new_memory
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.estimation.trace import mirrored
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.pipeline import Summarised, memory_after, summarise_passage

CHANNELS = ("all", "steering", "drift", "wheels")


def slipping_drive():
    """Return a drive whose wheels point farther into the bends than it goes: the front axle slips, the rear follows."""
    trace, _ = drive_over(s_turn, swing_mps=1.0, approach_m=200.0, exit_m=120.0)
    return replace(with_noise(trace, np.random.default_rng(4)), steer_rad=1.5 * trace.steer_rad)


def grip_of(trace, section):
    """Return the grip features by name."""
    outcome = summarise_passage(trace, section)
    assert isinstance(outcome, Summarised), outcome
    values = outcome.summary.values
    return {name: values[GRIP_TABLE.index(name)] for name in NAMES}


def test_the_mirrored_drive_on_the_mirrored_road_has_the_same_grip():
    trace = slipping_drive()
    here = grip_of(trace, road(s_turn, cross_slope_ratio=0.02))
    there = grip_of(mirrored(trace), road(negative(s_turn), cross_slope_ratio=-0.02))
    assert list(there.values()) == pytest.approx(list(here.values()), rel=1e-6, abs=1e-6)


def test_wheels_made_of_a_reference_speed_tell_nothing():
    trace, section = slipping_drive(), road(s_turn)
    wheels = tuple(f"wheel_{place}_mps" for place in ("front_left", "front_right", "rear_left", "rear_right"))
    whole, told = grip_of(trace, section), grip_of(replace(trace, absent=wheels), section)
    width = told["grip_wheels_below_1sd_ratio"] + told["grip_wheels_above_1sd_ratio"]
    assert width > np.log(1.25 / 0.1) - 1e-9
    for channel in ("steering", "drift"):
        own = with_best_of_channels(whole)[f"grip_{channel}_best_mu"]
        assert with_best_of_channels(told)[f"grip_{channel}_best_mu"] == pytest.approx(own, rel=1e-9)


@pytest.mark.parametrize("name", ["accel_y_mps2", "accel_x_mps2", "roll_rate_radps", "steer_rad"])
def test_an_absent_sensor_leaves_numbers_within_their_ranges(name):
    trace = slipping_drive()
    lacking = replace(trace, **{name: np.zeros(trace.samples_count)}, absent=(name,))
    for feature, value in grip_of(lacking, road(s_turn)).items():
        column = GRIP_TABLE.features[GRIP_TABLE.index(feature)]
        assert column.minimum <= value <= column.maximum, feature


def test_without_the_lateral_accelerometer_no_channel_speaks_and_the_demand_is_about_what_it_was():
    trace, section = slipping_drive(), road(s_turn)
    whole = grip_of(trace, section)
    blind = grip_of(replace(trace, accel_y_mps2=np.zeros(trace.samples_count), absent=("accel_y_mps2",)), section)
    for channel in CHANNELS:
        assert blind[f"grip_{channel}_misfit_ratio"] == 0.0
    assert blind["force_y_max_mps2"] == pytest.approx(whole["force_y_max_mps2"], rel=0.1)
    assert blind["demand_q95_mu"] == pytest.approx(whole["demand_q95_mu"], rel=0.1)


def test_a_car_that_lacks_a_sensor_learns_nothing_of_itself():
    outcome = summarise_passage(slipping_drive(), road(s_turn))
    assert isinstance(outcome, Summarised)
    memory = new_memory(handling_std_ratio=0.1)

    def after(sensed):
        return memory_after(
            sensed, memory, friction_mu=0.5, vehicle=XC90, handling=XC90_HANDLING, noise=AUTOMOTIVE_NOISE
        )

    assert after(replace(outcome.sensed, absent=("steer_rad",))) == memory
    assert after(replace(outcome.sensed, absent=("roll_rate_radps",))) == after(outcome.sensed) != memory


@pytest.mark.sim
@pytest.mark.parametrize("grade", ["automotive", "ideal"])
def test_simulated_drives_tell_numbers_within_their_ranges_and_more_grip_where_there_is_more(grade):
    from roadgrip.sections import read_section
    from vehicle_client.simulator.run import SensorGrade, draw_plan, simulate_passage

    section, best = read_section("s-turn"), []
    for base_friction_mu in (0.15, 0.25, 0.7):
        plan = draw_plan(
            np.random.default_rng(21),
            section=section,
            base_friction_mu=base_friction_mu,
            grade=SensorGrade(grade),
            with_gnss=True,
        )
        told = grip_of(simulate_passage(section, plan).trace, section)
        for feature, value in told.items():
            column = GRIP_TABLE.features[GRIP_TABLE.index(feature)]
            assert column.minimum <= value <= column.maximum, feature
        best.append(told["grip_all_best_mu"])
    assert best == sorted(best)
    assert best[-1] > 1.5 * best[0]
