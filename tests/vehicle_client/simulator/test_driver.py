import pytest

from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.simulator.rig import Rig
from vehicle_client.simulator import lanes
from vehicle_client.simulator.driver import choose_steering, understeer_gradient_s2pm
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim


@pytest.mark.parametrize("cross_slope_ratio", [-0.06, 0.0, 0.06])
@pytest.mark.parametrize("curvature_1pm", [-0.01, 0.0, 0.01])
def test_he_steers_for_the_bend_and_against_the_bank(cross_slope_ratio, curvature_1pm):
    rig = Rig(speed_mps=20.0)
    rig.of_wheels(lanes.AHEAD_CROSS_SLOPE)[:] = cross_slope_ratio
    for row in (lanes.CURVATURE, lanes.AHEAD_CURVATURE):
        rig.of_wheels(row)[:] = curvature_1pm
    rig.of_wheels(lanes.YAW_RATE)[:] = 20.0 * curvature_1pm
    choose_steering(rig.state, 0)
    # The tyres' lateral force is what the bend needs and what holds the car against the bank.
    force_mps2 = 20.0**2 * curvature_1pm + GRAVITY_MPS2 * cross_slope_ratio
    expected = XC90.wheelbase_m * curvature_1pm + understeer_gradient_s2pm(XC90) * force_mps2
    assert rig.of_body(lanes.STEER_WISH) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("row", "value"), [(lanes.OFFSET, 0.5), (lanes.ANGLE, 0.02), (lanes.YAW_RATE, 0.05)])
def test_he_steers_back_from_where_he_has_come_off(row, value):
    for sign in (-1.0, 1.0):
        rig = Rig(speed_mps=20.0)
        rig.of_wheels(row)[:] = sign * value
        choose_steering(rig.state, 0)
        assert sign * rig.of_body(lanes.STEER_WISH) < 0.0
