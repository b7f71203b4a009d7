import numpy as np
import pytest

from tests.vehicle_client.simulator.rig import Rig, curvy_road
from vehicle_client.simulator import journey, lanes
from vehicle_client.simulator.plan import FrictionProfile, PassagePlan, SensorGrade
from vehicle_client.simulator.run import simulate_passage
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim


def reported(rig, column):
    journey.report(rig.state, 0)
    return float(rig.state[lanes.REPORT + column * lanes.WHEELS])


def test_a_body_lifted_on_the_left_by_the_road_has_rolled_to_the_right():
    rig = Rig()
    rig.of_wheels(lanes.SPRUNG_Z)[:] = [0.02, 0.0, 0.02, 0.0]
    rig.of_wheels(lanes.SPRUNG_V)[:] = [0.3, 0.0, 0.3, 0.0]
    track_m = 0.5 * (XC90.front_track_m + XC90.rear_track_m)
    assert reported(rig, journey.LOG_ROLL) == pytest.approx(0.02 / track_m)
    assert reported(rig, journey.LOG_SENSED_RATE) == pytest.approx(0.3 / track_m)


def test_a_body_lifted_evenly_does_not_roll():
    rig = Rig()
    rig.of_wheels(lanes.SPRUNG_Z)[:] = 0.02
    assert reported(rig, journey.LOG_ROLL) == 0.0


def test_utilisation_is_the_larger_share_of_its_grip_that_an_axle_uses():
    profile = FrictionProfile(
        station_m=np.array([-100.0, 500.0]), left_mu=np.array([0.5, 0.5]), right_mu=np.array([0.35, 0.35])
    )
    plan = PassagePlan(
        base_friction_mu=0.5, seed=3, sensor_grade=SensorGrade.IDEAL, friction_profile=profile, target_speed_mps=13.0
    )
    truth = simulate_passage(curvy_road(), plan).truth
    shares = []
    for axle in (slice(0, 2), slice(2, 4)):
        force = np.hypot(truth.wheel_force_x_n[:, axle].sum(1), truth.wheel_force_y_n[:, axle].sum(1))
        shares.append(force / (truth.wheel_load_n[:, axle] @ [0.5, 0.35]))
    np.testing.assert_allclose(truth.utilisation_ratio, np.max(shares, axis=0), rtol=1e-9, atol=1e-12)
    assert truth.utilisation_ratio.max() > 0.5
