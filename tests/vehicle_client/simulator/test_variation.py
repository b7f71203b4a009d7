"""Drawn cars: plausible one by one, consistent in themselves, different from each other, and fit to drive."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.sections import read_section
from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.simulator.rig import Rig
from vehicle_client.simulator import chassis, lanes
from vehicle_client.simulator.driver import understeer_gradient_s2pm
from vehicle_client.simulator.plan import PassagePlan
from vehicle_client.simulator.run import simulate_passage
from vehicle_client.simulator.variation import CLASSES, PAYLOAD_RANGE_KG, draw_vehicle, geometry_of, is_sound
from vehicle_client.simulator.vehicle import XC90, Vehicle

pytestmark = pytest.mark.sim

vehicles = st.integers(0, 2**32).map(lambda seed: draw_vehicle(np.random.default_rng(seed)))


@given(vehicle=vehicles)
def test_every_car_understeers_at_small_lateral_acceleration(vehicle: Vehicle) -> None:
    assert understeer_gradient_s2pm(vehicle) > 0.0


@given(vehicle=vehicles)
def test_every_wheel_bears_a_load_that_its_tyre_is_made_for(vehicle: Vehicle) -> None:
    rig = Rig(speed_mps=0.0, vehicle=vehicle)
    chassis.advance(rig.state, rig.step_s)
    load_n = rig.of_wheels(lanes.LOAD)
    assert load_n.sum() == pytest.approx(vehicle.mass_kg * GRAVITY_MPS2)
    assert (load_n > 0.5 * vehicle.tyre.nominal_load_n).all()
    assert (load_n < 1.6 * vehicle.tyre.nominal_load_n).all()


@given(vehicle=vehicles)
def test_the_inertias_are_those_of_a_car(vehicle: Vehicle) -> None:
    track_m = 0.5 * (vehicle.front_track_m + vehicle.rear_track_m)
    dynamic_index_ratio = vehicle.yaw_inertia_kgm2 / (vehicle.mass_kg * vehicle.front_axle_m * vehicle.rear_axle_m)
    assert 0.65 < dynamic_index_ratio < 1.1  # people sit between the axles, which lowers it
    assert 0.33 < np.sqrt(vehicle.roll_inertia_kgm2 / vehicle.mass_kg) / track_m < 0.45


@given(vehicle=vehicles)
def test_tyres_slide_before_a_car_tips_over(vehicle: Vehicle) -> None:
    half_track_m = 0.25 * (vehicle.front_track_m + vehicle.rear_track_m)
    assert half_track_m / vehicle.cog_height_m > 1.0


@given(vehicle=vehicles)
def test_it_leans_as_springs_of_a_car_let_it(vehicle: Vehicle) -> None:
    arm_m = vehicle.cog_height_m - (
        vehicle.front_roll_centre_m * vehicle.rear_axle_m + vehicle.rear_roll_centre_m * vehicle.front_axle_m
    ) / (vehicle.wheelbase_m)
    moment_nm = vehicle.mass_kg * GRAVITY_MPS2 * arm_m
    lean_rad = moment_nm / (vehicle.roll_stiffness_nmprad - moment_nm)
    assert 3.0 < np.rad2deg(lean_rad) < 9.0


@given(vehicle=vehicles)
def test_every_number_is_positive_but_for_the_driven_axle(vehicle: Vehicle) -> None:
    for name, value in vehicle._asdict().items():
        if name == "tyre":
            assert all(number > 0.0 for number in value)
        else:
            assert value > 0.0 or (name == "front_drive_frac" and value == 0.0), name
    assert vehicle.front_drive_frac <= 1.0
    assert vehicle.front_brake_frac < 0.9


def test_a_draw_takes_the_same_chance_whatever_car_comes_out() -> None:
    left = set()
    for seed in range(50):
        rng, other = np.random.default_rng(seed), np.random.default_rng(seed)
        draw_vehicle(rng)
        other.integers(2**63, size=2)
        left.add(rng.random() == other.random())
    assert left == {True}


def test_the_same_chance_gives_the_same_car_and_other_chance_another() -> None:
    fleet = [draw_vehicle(np.random.default_rng(seed)) for seed in range(20)]
    assert fleet == [draw_vehicle(np.random.default_rng(seed)) for seed in range(20)]
    assert len(set(fleet)) == 20


def test_the_fleet_spans_small_cars_and_loaded_vans() -> None:
    masses_kg = np.array([draw_vehicle(np.random.default_rng(seed)).mass_kg for seed in range(400)])
    assert masses_kg.min() < 1150.0
    assert masses_kg.max() > 2300.0
    assert 1500.0 < masses_kg.mean() < 1900.0
    lightest_kg, heaviest_kg = min(c.mass_kg[0] for c in CLASSES), max(c.mass_kg[1] for c in CLASSES)
    assert lightest_kg + PAYLOAD_RANGE_KG[0] <= masses_kg.min()
    assert masses_kg.max() <= heaviest_kg + PAYLOAD_RANGE_KG[1]


def test_shares_of_the_classes_add_up() -> None:
    assert sum(c.share_frac for c in CLASSES) == pytest.approx(1.0)
    assert all(c.front_driven_frac + c.all_driven_frac <= 1.0 for c in CLASSES)


def test_the_papers_car_is_sound_and_one_with_its_weight_behind_is_not() -> None:
    assert is_sound(XC90)
    assert not is_sound(XC90._replace(front_axle_m=2.5, rear_axle_m=0.484))
    assert not is_sound(XC90._replace(cog_height_m=0.9))


def test_the_client_knows_where_wheels_and_centre_of_gravity_are() -> None:
    vehicle = draw_vehicle(np.random.default_rng(4))
    geometry = geometry_of(vehicle)
    assert geometry.front_axle_m + vehicle.rear_axle_m == pytest.approx(geometry.wheelbase_m)
    assert min(vehicle.front_track_m, vehicle.rear_track_m) <= geometry.track_m
    assert geometry_of(XC90).wheelbase_m == pytest.approx(2.984)


@pytest.mark.parametrize("seed", range(12))
def test_every_car_drives_the_sharp_turn(seed: int) -> None:
    plan = PassagePlan(base_friction_mu=0.5, seed=seed, vehicle=draw_vehicle(np.random.default_rng(seed)))
    drive = simulate_passage(read_section("sharp-turn"), plan)
    assert drive.completed
    assert np.abs(drive.truth.lateral_offset_m).max() < 1.0
