"""What the estimation makes of real cars, judged by their reference instruments.

The numbers are golden: a change of the estimation shows up here, in either direction. They are not promises; the
constants of the observer belong to another car.
"""

from dataclasses import fields, replace

import numpy as np
import pytest

from roadgrip.records import QualityFlag, Reason, Rejected
from tests.replay.ferrari import CURVE_M, DRIVE_SAMPLES, FERRARI_GEOMETRY, curve_section_and_trace, recorded_line
from tests.replay.recordings import FERRARI, FOLDER, INDY, MOTORWAY, recording, rms
from training.observer_tuning import tune
from training.reference_drives import ReferenceFormat, level_road, parts_of_recording, recording_with_reference
from vehicle_client.estimation.filters import rate_of_change, smoothed
from vehicle_client.estimation.observer import XC90_PARAMETERS
from vehicle_client.estimation.offsets import NO_OFFSETS
from vehicle_client.estimation.signals import kinematic_signals, unmapped_speed_mps
from vehicle_client.estimation.trace import mirrored
from vehicle_client.mapmatch.driven_line import driven_line
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.recording.public import IAC_AV21

INDY_GEOMETRY = IAC_AV21.vehicle


# The Ferrari: a real curve through the whole pipeline ----------------------------------------------------------------


def test_a_real_curve_becomes_a_summary():
    section, trace = curve_section_and_trace()
    assert 280.0 < section.length_m < 320.0
    assert 30.0 < section.tightest_radius_m < 45.0
    result = summarise_passage(trace, section, vehicle=FERRARI_GEOMETRY)
    assert isinstance(result, Summarised), result
    assert QualityFlag.REFERENCE_SPEED | QualityFlag.NO_GNSS in result.summary.quality
    assert np.isfinite(result.summary.values).all()


def test_the_curve_is_found_where_the_next_lap_passes_it():
    # Map from one lap, drive from the next: where the reckoned line of the whole recording comes nearest to the
    # section's two ends. That line drifts by metres per lap, so this is no better than 15 m.
    section, trace = curve_section_and_trace()
    result = summarise_passage(trace, section, vehicle=FERRARI_GEOMETRY)
    assert isinstance(result, Summarised), result
    line = recorded_line()
    lap = slice(*DRIVE_SAMPLES)
    for station, found_s in ((CURVE_M[0], result.match.entry_s), (CURVE_M[1], result.match.exit_s)):
        x, y = (np.interp(station, line.distance_m, along) for along in (line.x_m, line.y_m))
        nearest = int(np.argmin(np.hypot(line.x_m[lap] - x, line.y_m[lap] - y)))
        gap_m = line.distance_m[lap][nearest] - np.interp(found_s, trace.time_s, line.distance_m[lap])
        assert abs(gap_m) < 15.0


def test_the_curve_is_found_in_nine_minutes_of_driving():
    section, _ = curve_section_and_trace()
    result = summarise_passage(recording(FERRARI).trace, section, vehicle=FERRARI_GEOMETRY)
    assert isinstance(result, Summarised), result
    assert section.length_m / 30.0 < result.summary.duration_s < section.length_m / 18.0


def test_the_mirrored_drive_is_refused():
    section, trace = curve_section_and_trace()
    outcome = summarise_passage(mirrored(trace), section, vehicle=FERRARI_GEOMETRY)
    assert isinstance(outcome, Rejected), outcome
    assert outcome.reason is Reason.WRONG_ROAD


def _whole_ferrari(parameters):
    """Return estimate and truth of the sideslip over all 550 s; bank and grade of the track are not known."""
    drive = recording(FERRARI)
    signals = kinematic_signals(
        drive.trace,
        level_road(),
        station_m=np.zeros(drive.trace.samples_count),
        vehicle=FERRARI_GEOMETRY,
        parameters=parameters,
        offsets=NO_OFFSETS,
    )
    return signals.sideslip_rad, drive.reference["sideslip_rad"]


def _with_widths(factor):
    """Return the XC90's constants with F(t) always one (large) or, in motion, never anything (small)."""
    widths = [f.name for f in fields(XC90_PARAMETERS) if f.name.startswith("sigma_") and "wheel" not in f.name]
    assert len(widths) == 6
    return replace(XC90_PARAMETERS, **{name: factor * getattr(XC90_PARAMETERS, name) for name in widths})


@pytest.mark.parametrize(
    ("parameters", "pulled_to_zero", "error_rad", "correlation", "gain"),
    [
        (XC90_PARAMETERS, False, 0.0103, 0.956, 1.10),
        (_with_widths(1e6), False, 0.0080, 0.977, 1.11),
        (_with_widths(1e-6), False, 0.0130, 0.940, 1.15),
        (XC90_PARAMETERS, True, 0.0181, 0.792, 0.59),
        (_with_widths(1e6), True, 0.0249, 0.633, 0.19),
        (_with_widths(1e-6), True, 0.0191, 0.754, 0.63),
        # This car's roll gradient, as its reference tells it on the first half: a quarter of the XC90's.
        (replace(XC90_PARAMETERS, roll_gradient_s2pm=0.00217), False, 0.0071, 0.978, 1.07),
    ],
    ids=["ours", "f_one", "f_zero", "to_zero", "f_one_to_zero", "f_zero_to_zero", "own_roll_gradient"],
)
def test_sideslip_of_the_ferrari_over_the_whole_recording(parameters, pulled_to_zero, error_rad, correlation, gain):
    # Against "no sideslip at all", which is the honest yardstick. Without wheel speeds and roll rate, and with the
    # constants of a car that weighs twice as much.
    estimate, truth = _whole_ferrari(replace(parameters, grip_pull_ratio=0.0) if pulled_to_zero else parameters)
    assert rms(truth) == pytest.approx(0.0295, abs=0.0002)
    assert rms(estimate - truth) == pytest.approx(error_rad, abs=0.0005)
    assert np.corrcoef(estimate, truth)[0, 1] == pytest.approx(correlation, abs=0.01)
    assert float(estimate @ truth / (truth @ truth)) == pytest.approx(gain, abs=0.03)


def test_constants_tuned_to_one_half_of_the_ferrari_help_on_the_other():
    data = (FOLDER / FERRARI).read_bytes() if (FOLDER / FERRARI).is_file() else pytest.skip("no recording")
    drive = recording_with_reference(data, ReferenceFormat.FERRARI_250LM, place=FERRARI)
    first, rest = parts_of_recording(drive, name="halves", vehicle=FERRARI_GEOMETRY, tuned_frac=0.5)
    assert rest is not None
    tuning = tune(
        [first],
        [rest],
        XC90_PARAMETERS,
        constants=["rear_slip_gradient_s2pm", "roll_gradient_s2pm", "roll_crossover_hz"],
        evaluations_limit_count=40,
        seed=1,
    )
    assert tuning.held_out is not None
    before, after = tuning.held_out
    assert before.judged_s > 250.0
    assert after.rms_rad < 0.75 * before.rms_rad
    assert after.rms_rad < 0.25 * after.truth_rms_rad


def test_sideslip_of_the_ferrari_in_the_curve():
    section, trace = curve_section_and_trace()
    result = summarise_passage(trace, section, vehicle=FERRARI_GEOMETRY)
    assert isinstance(result, Summarised), result
    inside = result.match.inside(trace.time_s)
    truth = recording(FERRARI).reference["sideslip_rad"][slice(*DRIVE_SAMPLES)][inside]
    assert rms(truth) == pytest.approx(0.0392, abs=0.0005)
    assert rms(result.signals.sideslip_rad[inside] - truth) == pytest.approx(0.0149, abs=0.0005)


# The Indy car: four wheels against a reference speed -----------------------------------------------------------------


def test_the_speed_block_beats_the_plain_mean_of_four_wheels():
    drive = recording(INDY)
    trace, truth = drive.trace, drive.reference["velocity_x_mps"]
    assert set(drive.missing) == {"accel_y_mps2", "roll_rate_radps"}
    block = unmapped_speed_mps(trace, vehicle=INDY_GEOMETRY, parameters=XC90_PARAMETERS)
    mean = trace.wheel_speed_mps.mean(axis=1)

    def error_mps(speed):
        # The nominal rolling radius is 1.3 % too large; either contender gets its own best radius.
        return rms(speed * float(speed @ truth / (speed @ speed)) - truth)

    assert error_mps(block) == pytest.approx(0.0574, abs=0.001)
    assert error_mps(mean) == pytest.approx(0.0685, abs=0.001)


# The motorway: which way the axes point ------------------------------------------------------------------------------


def test_gravity_points_down_in_the_motorway_car():
    up = recording(MOTORWAY).reference["imu_up_mps2"]
    assert np.median(up) == pytest.approx(9.81, abs=0.25)


def test_speeding_up_is_forward_in_the_motorway_car():
    drive = recording(MOTORWAY)
    gained = rate_of_change(smoothed(drive.reference["velocity_x_mps"]))
    assert np.corrcoef(smoothed(drive.trace.accel_x_mps2), gained)[0, 1] > 0.8


def test_turning_left_is_positive_everywhere_in_the_motorway_car():
    trace = recording(MOTORWAY).trace
    yaw_rate = smoothed(trace.yaw_rate_radps)
    right_faster = smoothed(trace.wheel_speed_mps[:, 3] - trace.wheel_speed_mps[:, 2])
    assert np.corrcoef(smoothed(trace.steer_rad), yaw_rate)[0, 1] > 0.7
    assert np.corrcoef(right_faster, yaw_rate)[0, 1] > 0.1
    speed = trace.wheel_speed_mps.mean(axis=1)
    assert np.corrcoef(smoothed(trace.accel_y_mps2), yaw_rate * speed)[0, 1] > 0.2


def test_a_motorway_is_no_curve():
    section, _ = curve_section_and_trace()
    outcome = summarise_passage(recording(MOTORWAY).trace, section)
    assert isinstance(outcome, Rejected), outcome
    assert outcome.reason is Reason.WRONG_ROAD


def test_the_line_of_a_lap_closes():
    # 3.1 km and one turn of the whole circle: where the car passes the curve's start again, the reckoned line does.
    line = recorded_line()
    lap = np.searchsorted(line.distance_m, [CURVE_M[0], CURVE_M[0] + 3106.0])
    gap = np.hypot(np.diff(line.x_m[lap]), np.diff(line.y_m[lap]))[0]
    assert gap < 25.0
    assert driven_line(np.zeros(5), np.zeros(5)).distance_m[-1] == 0.0
