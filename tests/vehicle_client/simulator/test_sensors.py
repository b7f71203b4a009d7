"""What sensors make of a motion that is known: the sizes of their errors, and what stays exact."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.geodesy import frame_of
from roadgrip.sections import read_section
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from tests.vehicle_client.synthetic import clock_s
from vehicle_client.simulator.amplitudes import AUTOMOTIVE, IDEAL, SENSORS, Sensors, scaled
from vehicle_client.simulator.plan import SensorGrade
from vehicle_client.simulator.sensors import Motion, gnss_track, trace_of

pytestmark = pytest.mark.sim

CHANNELS = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad", "wheel_speed_mps")


def still(n=4000, *, yaw_rate_radps=0.0, speed_mps=0.0) -> Motion:
    force = np.zeros((n, 3))
    force[:, 2] = GRAVITY_MPS2
    rate = np.zeros((n, 3))
    rate[:, 2] = yaw_rate_radps
    return Motion(force, rate, np.zeros(n), np.full((n, 4), speed_mps), np.zeros(n, dtype=np.bool_))


def swaying(n=2000, *, hz=0.5) -> Motion:
    """Return a motion in which everything changes all the time."""
    t = clock_s(n)
    w = 2.0 * np.pi * hz
    force = np.column_stack([2.0 * np.sin(w * t), 5.0 * np.cos(w * t), GRAVITY_MPS2 + 0.3 * np.sin(2.0 * w * t)])
    rate = np.column_stack([0.1 * np.cos(w * t), 0.05 * np.sin(w * t), 0.3 * np.sin(w * t)])
    wheels = 20.0 + np.sin(w * t)[:, None] * np.ones(4)
    return Motion(force, rate, 0.05 * np.sin(w * t), wheels, np.zeros(n, dtype=np.bool_))


def only(**amplitudes: float) -> Sensors:
    """Return sensors that are exact but for these errors."""
    return IDEAL._replace(**amplitudes)


def spread_over_drives(motion: Motion, sensors: Sensors, channel: str, *, drives=1500) -> float:
    rng = np.random.default_rng(5)
    values = [np.mean(getattr(trace_of(motion, rng=rng, sensors=sensors), channel)) for _ in range(drives)]
    return float(np.std(values))


# Grades --------------------------------------------------------------------------------------------------------------


def test_every_grade_has_its_amplitudes():
    assert set(SENSORS) == set(SensorGrade)


def test_exact_sensors_pass_the_motion_on(rng):
    motion = swaying()
    trace = trace_of(motion, rng=rng, sensors=IDEAL)
    assert np.array_equal(trace.accel_x_mps2, motion.specific_force_mps2[:, 0])
    assert np.array_equal(trace.accel_y_mps2, motion.specific_force_mps2[:, 1])
    assert np.array_equal(trace.roll_rate_radps, motion.rate_radps[:, 0])
    assert np.array_equal(trace.yaw_rate_radps, motion.rate_radps[:, 2])
    assert np.array_equal(trace.steer_rad, motion.steer_rad)
    assert np.array_equal(trace.wheel_speed_mps, motion.wheel_speed_mps)


def test_errors_a_million_times_as_small_are_next_to_none():
    # The compiled way agrees with the short one that exact sensors take.
    motion = swaying()
    exact = trace_of(motion, rng=np.random.default_rng(1), sensors=IDEAL)
    nearly = trace_of(motion, rng=np.random.default_rng(1), sensors=scaled(AUTOMOTIVE, 1e-6))
    for name in CHANNELS:
        assert np.allclose(getattr(nearly, name), getattr(exact, name), atol=1e-5), name


def test_the_trace_does_not_share_memory_with_the_motion(rng):
    motion = swaying(100)
    for sensors in SENSORS.values():
        trace = trace_of(motion, rng=rng, sensors=sensors)
        for name in CHANNELS:
            assert not any(np.shares_memory(getattr(trace, name), truth) for truth in motion[:4]), name


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 300))
def test_a_trace_is_a_function_of_motion_and_chance(seed, n):
    one, two = (trace_of(swaying(n), rng=np.random.default_rng(seed), sensors=AUTOMOTIVE) for _ in range(2))
    for name in CHANNELS:
        assert np.array_equal(getattr(one, name), getattr(two, name)), name
        assert np.isfinite(getattr(one, name)).all()


def test_scaled_grades_take_the_same_draws():
    one, two = np.random.default_rng(1), np.random.default_rng(1)
    trace_of(still(50), rng=one, sensors=AUTOMOTIVE)
    trace_of(still(50), rng=two, sensors=scaled(AUTOMOTIVE, 2.0))
    assert one.random() == two.random()


@given(ratio=st.floats(0.0, 10.0))
def test_scaling_touches_every_amplitude_and_nothing_else(ratio):
    kept = {"gnss_memory_s", "gnss_rate_hz", "map_memory_m"}
    for name, value in scaled(AUTOMOTIVE, ratio)._asdict().items():
        assert value == pytest.approx(getattr(AUTOMOTIVE, name) * (1.0 if name in kept else ratio)), name


def test_exact_sensors_are_automotive_ones_scaled_to_nothing():
    assert scaled(AUTOMOTIVE, 0.0) == IDEAL


@pytest.mark.parametrize("ratio", [-1.0, np.nan, np.inf])
def test_errors_cannot_be_less_than_none(ratio):
    with pytest.raises(ValueError, match="times as large"):
        scaled(AUTOMOTIVE, ratio)


def test_errors_twice_as_large_move_the_trace_twice_as_far():
    # Rounding to steps is no error that scales sample by sample.
    sensors = AUTOMOTIVE._replace(steer_quantum_rad=0.0, wheel_quantum_mps=0.0, mount_m=0.0, jitter_s=0.0)
    motion = still(500, yaw_rate_radps=0.2, speed_mps=20.0)
    exact = trace_of(motion, rng=np.random.default_rng(0), sensors=IDEAL)
    half, full = (trace_of(motion, rng=np.random.default_rng(9), sensors=scaled(sensors, r)) for r in (0.01, 0.02))
    for name in CHANNELS:
        truth = getattr(exact, name)
        assert np.allclose(getattr(full, name) - truth, 2.0 * (getattr(half, name) - truth), atol=2e-4), name


# Sizes ---------------------------------------------------------------------------------------------------------------


def test_noise_of_a_drive_has_the_stated_size(rng):
    trace = trace_of(still(speed_mps=20.0), rng=rng, sensors=AUTOMOTIVE._replace(wheel_quantum_mps=0.0))
    assert trace.yaw_rate_radps.std() == pytest.approx(AUTOMOTIVE.gyro_noise_radps, rel=0.1)
    assert trace.roll_rate_radps.std() == pytest.approx(AUTOMOTIVE.gyro_noise_radps, rel=0.1)
    # The controller's correction of the lever puts a little of the gyro's noise on top.
    assert trace.accel_x_mps2.std() == pytest.approx(AUTOMOTIVE.accel_noise_mps2, rel=0.1)
    assert trace.accel_y_mps2.std() == pytest.approx(AUTOMOTIVE.accel_noise_mps2, rel=0.1)
    for wheel in range(4):
        assert trace.wheel_speed_mps[:, wheel].std() == pytest.approx(0.06, rel=0.1)


def test_noise_is_bell_shaped_new_at_every_sample_and_in_every_channel(rng):
    trace = trace_of(still(40_000, speed_mps=20.0), rng=rng, sensors=only(gyro_noise_radps=1.0, wheel_noise_ratio=0.05))
    columns = [trace.roll_rate_radps, trace.yaw_rate_radps, *(trace.wheel_speed_mps.T - 20.0)]
    noise = np.array(columns)
    noise[2:] /= 20.0 * 0.05
    assert np.abs(noise.mean(axis=1)).max() < 0.02
    assert noise.std(axis=1) == pytest.approx(1.0, rel=0.015)
    # A normal variable: 31.7 and 4.6 %.
    assert (np.abs(noise) > 1.0).mean() == pytest.approx(0.317, abs=0.008)
    assert (np.abs(noise) > 2.0).mean() == pytest.approx(0.0455, abs=0.002)
    assert np.abs(noise).max() < 4.9
    assert np.abs(np.corrcoef(noise) - np.eye(6)).max() < 0.025
    assert np.abs((noise[:, 1:] * noise[:, :-1]).mean(axis=1)).max() < 0.025


def test_offsets_over_many_drives_have_the_stated_size():
    # A tilted unit sees a part of gravity besides its own bias.
    expected = np.hypot(AUTOMOTIVE.accel_bias_mps2, AUTOMOTIVE.misalignment_rad * GRAVITY_MPS2)
    for channel in ("accel_x_mps2", "accel_y_mps2"):
        assert spread_over_drives(still(10), AUTOMOTIVE._replace(accel_noise_mps2=0.0), channel) == pytest.approx(
            expected, rel=0.08
        )


@pytest.mark.parametrize(
    ("amplitude", "channel", "expected"),
    [
        ("gyro_bias_radps", "yaw_rate_radps", 1.0),
        ("gyro_bias_radps", "roll_rate_radps", 1.0),
        ("gyro_scale_ratio", "yaw_rate_radps", 0.2),
        ("accel_bias_mps2", "accel_x_mps2", 1.0),
        ("steer_offset_rad", "steer_rad", 1.0),
        ("radius_common_ratio", "wheel_speed_mps", 20.0),
        ("radius_each_ratio", "wheel_speed_mps", 10.0),  # a mean of four
        ("mount_error_m", "accel_x_mps2", 0.04),  # centripetal: yaw rate squared
        ("mount_error_m", "accel_y_mps2", 0.04),
        ("misalignment_rad", "accel_y_mps2", GRAVITY_MPS2),
    ],
)
def test_each_lasting_error_alone_has_the_stated_size(amplitude, channel, expected):
    size = getattr(AUTOMOTIVE, amplitude)
    motion = still(10, yaw_rate_radps=0.2, speed_mps=20.0)
    spread = spread_over_drives(motion, only(**{amplitude: size}), channel)
    assert spread == pytest.approx(expected * size, rel=0.08)


def test_a_car_keeps_its_errors_over_drives_but_for_the_gyros_offsets():
    """Noise averages out over a long drive; what is left is the car's, and the drive's own offset of the gyro."""
    motion = still(200_000, speed_mps=20.0)
    drives = [
        trace_of(motion, rng=np.random.default_rng(k), sensors=AUTOMOTIVE, car_rng=np.random.default_rng(7))
        for k in range(3)
    ]
    for channel, least in (("accel_x_mps2", 0.01), ("accel_y_mps2", 0.01), ("wheel_speed_mps", 0.01)):
        means = [np.mean(getattr(drive, channel)) for drive in drives]
        assert np.ptp(means) < least
    assert np.ptp([np.mean(drive.yaw_rate_radps) for drive in drives]) > 1e-4


def test_another_car_errs_otherwise_with_the_same_noise():
    motion = still(1000)
    sensors = only(accel_noise_mps2=0.03, accel_bias_mps2=0.05)
    one, other, nobody = (
        trace_of(motion, rng=np.random.default_rng(1), sensors=sensors, car_rng=car_rng)
        for car_rng in (np.random.default_rng(7), np.random.default_rng(8), None)
    )
    for changed in (other, nobody):
        difference = changed.accel_y_mps2 - one.accel_y_mps2
        assert np.ptp(difference) < 1e-12
        assert abs(difference[0]) > 1e-3


def test_steering_and_wheel_speeds_come_in_steps(rng):
    motion = still()._replace(
        steer_rad=np.linspace(-0.1, 0.1, 4000), wheel_speed_mps=np.linspace(5.0, 10.0, 16000).reshape(4000, 4)
    )
    trace = trace_of(motion, rng=rng, sensors=AUTOMOTIVE)
    assert np.diff(np.unique(trace.steer_rad)) == pytest.approx(AUTOMOTIVE.steer_quantum_rad)
    steps = trace.wheel_speed_mps / AUTOMOTIVE.wheel_quantum_mps
    assert np.allclose(steps, np.rint(steps), atol=1e-6)


# Time ----------------------------------------------------------------------------------------------------------------


def test_jitter_moves_every_channel_by_its_slope(rng):
    motion = swaying(4000)
    exact = trace_of(motion, rng=rng, sensors=IDEAL)
    trace = trace_of(motion, rng=rng, sensors=only(jitter_s=0.002))
    for name in CHANNELS:
        slope = np.gradient(getattr(exact, name), SAMPLE_S, axis=0)
        error = getattr(trace, name) - getattr(exact, name)
        assert np.sqrt((error**2).mean()) == pytest.approx(0.002 * np.sqrt((slope**2).mean()), rel=0.1), name


def test_each_sender_jitters_by_itself_and_all_its_channels_together(rng):
    ramp = np.linspace(0.0, 1.0, 4000)
    motion = Motion(
        np.column_stack([ramp, ramp, ramp]),
        np.column_stack([ramp, ramp, 0.0 * ramp]),
        ramp,
        np.column_stack([ramp] * 4),
        np.zeros(4000, dtype=np.bool_),
    )
    trace = trace_of(motion, rng=rng, sensors=only(jitter_s=0.002))
    inner = slice(10, -10)

    def error(values):
        return (values - ramp)[inner]

    unit, steering, brakes = error(trace.accel_x_mps2), error(trace.steer_rad), error(trace.wheel_speed_mps[:, 0])
    assert np.allclose(unit, error(trace.accel_y_mps2), atol=1e-12)
    assert np.allclose(unit, error(trace.roll_rate_radps), atol=1e-12)
    assert np.allclose(brakes, error(trace.wheel_speed_mps[:, 3]), atol=1e-12)
    for one, other in ((unit, steering), (unit, brakes), (steering, brakes)):
        assert abs(np.corrcoef(one, other)[0, 1]) < 0.06


def test_time_stamps_of_the_trace_are_the_grid(rng):
    trace = trace_of(still(50), rng=rng, sensors=AUTOMOTIVE)
    assert np.array_equal(trace.time_s, SAMPLE_S * np.arange(50))


# The place of the inertial unit --------------------------------------------------------------------------------------


def test_a_known_place_of_the_unit_is_corrected(rng):
    motion = swaying(hz=0.5)
    trace = trace_of(motion, rng=rng, sensors=only(mount_m=0.1))
    beside = 0.1 * np.abs(np.gradient(motion.rate_radps[:, 2], SAMPLE_S)).max()
    inner = slice(10, -10)
    left = np.abs(trace.accel_y_mps2 - motion.specific_force_mps2[:, 1])[inner].max()
    assert left < 0.02 * beside


def test_in_quick_turns_of_the_car_the_correction_falls_short_as_a_difference_over_a_tenth_of_a_second_does(rng):
    hz = 2.0
    motion = swaying(hz=hz)
    trace = trace_of(motion, rng=rng, sensors=only(mount_m=0.1))
    beside = 0.1 * np.abs(np.gradient(motion.rate_radps[:, 2], SAMPLE_S)).max()
    left = np.abs(trace.accel_y_mps2 - motion.specific_force_mps2[:, 1])[10:-10].max()
    assert left == pytest.approx((1.0 - np.sinc(2.0 * hz * 0.05)) * beside, rel=0.1)


# Positions -----------------------------------------------------------------------------------------------------------


def fixes(rng, *, sensors=AUTOMOTIVE, seconds=60.0, speed_mps=20.0):
    section = read_section("long-turn")
    t = clock_s(int(seconds / SAMPLE_S))
    frame = frame_of(section)
    track = gnss_track(speed_mps * t, 0.0 * t, frame=frame, rng=rng, sensors=sensors)
    x, y = frame.to_local(track.lat_deg, track.lon_deg)
    return track, x - speed_mps * SAMPLE_S * 10 * np.arange(len(x)), y


def test_fixes_come_ten_times_a_second(rng):
    track, _, _ = fixes(rng)
    assert len(track.time_s) == 600
    assert np.diff(track.time_s) == pytest.approx(0.1, abs=1e-9)


def test_positions_are_off_by_the_stated_size_over_many_drives():
    rng = np.random.default_rng(3)
    errors = np.array([[error[0] for error in fixes(rng, seconds=0.1)[1:]] for _ in range(800)])
    assert errors.std(axis=0) == pytest.approx(AUTOMOTIVE.gnss_position_m, rel=0.1)


def test_position_errors_drift_over_minutes(rng):
    _, x, _ = fixes(rng, seconds=3600.0, speed_mps=0.0)
    lag = round(AUTOMOTIVE.gnss_memory_s * AUTOMOTIVE.gnss_rate_hz)
    step = x[1:] - x[:-1]
    assert step.std() == pytest.approx(AUTOMOTIVE.gnss_position_m * np.sqrt(2.0 / lag), rel=0.1)


def test_the_speed_of_fixes_is_off_by_the_stated_size(rng):
    track, _, _ = fixes(rng, seconds=300.0)
    assert track.speed_mps is not None
    assert track.speed_mps.mean() == pytest.approx(20.0, abs=0.01)
    assert track.speed_mps.std() == pytest.approx(AUTOMOTIVE.gnss_speed_mps, rel=0.1)
    exact, x, y = fixes(rng, sensors=IDEAL)
    assert exact.speed_mps is not None
    assert exact.speed_mps == pytest.approx(20.0)
    assert np.abs(np.concatenate([x, y])).max() < 0.02
