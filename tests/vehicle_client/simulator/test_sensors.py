import numpy as np
import pytest

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.simulator.sensors import AUTOMOTIVE, IDEAL, Motion, trace_of


def still(n=4000, *, yaw_rate_radps=0.0, speed_mps=0.0):
    force = np.zeros((n, 3))
    force[:, 2] = GRAVITY_MPS2
    rate = np.zeros((n, 3))
    rate[:, 2] = yaw_rate_radps
    return Motion(force, rate, np.zeros(n), np.full((n, 4), speed_mps), np.zeros(n, dtype=np.bool_))


def test_ideal_sensors_add_nothing(rng):
    trace = trace_of(still(yaw_rate_radps=0.2, speed_mps=20.0), rng=rng, sensors=IDEAL)
    assert (trace.yaw_rate_radps == 0.2).all()
    assert (trace.wheel_speed_mps == 20.0).all()
    assert (trace.accel_y_mps2 == 0.0).all()


def test_noise_of_a_drive_has_the_stated_size(rng):
    trace = trace_of(still(speed_mps=20.0), rng=rng, sensors=AUTOMOTIVE)
    assert trace.yaw_rate_radps.std() == pytest.approx(AUTOMOTIVE.gyro_noise_radps, rel=0.1)
    assert trace.accel_x_mps2.std() == pytest.approx(AUTOMOTIVE.accel_noise_mps2, rel=0.1)
    assert trace.wheel_speed_mps[:, 0].std() == pytest.approx(0.06, rel=0.1)


def test_offsets_over_many_drives_have_the_stated_size(rng):
    drives = [trace_of(still(10), rng=rng, sensors=AUTOMOTIVE._replace(accel_noise_mps2=0.0)) for _ in range(1500)]
    offsets = np.array([d.accel_y_mps2[0] for d in drives])
    # A tilted unit sees a part of gravity besides its own bias.
    expected = np.hypot(AUTOMOTIVE.accel_bias_mps2, AUTOMOTIVE.misalignment_rad * GRAVITY_MPS2)
    assert offsets.std() == pytest.approx(expected, rel=0.08)
    assert abs(offsets.mean()) < 0.01


def test_steering_comes_in_steps(rng):
    motion = still()._replace(steer_rad=np.linspace(-0.1, 0.1, 4000))
    steps = np.unique(trace_of(motion, rng=rng, sensors=AUTOMOTIVE).steer_rad)
    assert np.diff(steps) == pytest.approx(AUTOMOTIVE.steer_quantum_rad)


def test_a_grade_takes_as_many_draws_as_another():
    one, two = np.random.default_rng(1), np.random.default_rng(1)
    trace_of(still(50), rng=one, sensors=IDEAL)
    trace_of(still(50), rng=two, sensors=AUTOMOTIVE)
    assert one.random() == two.random()
