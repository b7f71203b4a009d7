"""Three recorded cars: their sensors are not called faulty, and what breaks in them is."""

from dataclasses import replace

import numpy as np
import pytest

from tests.replay.recordings import FERRARI, INDY, MAPPINGS, MOTORWAY, recording
from vehicle_client.estimation.gaps import believable, bridged
from vehicle_client.estimation.observer import XC90_PARAMETERS
from vehicle_client.estimation.plausibility import Finding, Sensor, findings
from vehicle_client.estimation.signals import unmapped_speed_mps
from vehicle_client.estimation.trace import Trace, part_of
from vehicle_client.simulator.faults import Fault, with_fault

WINDOW_S = 20.0
STEP_S = 10.0
IN_BENDS_S = {FERRARI: 161.0, INDY: 200.0}
"""A stretch of each in which it turns."""
SEEN: dict[tuple[str, Fault], Sensor | None] = {
    (FERRARI, Fault.GYRO_DEAD): Sensor.GYRO,
    (FERRARI, Fault.GYRO_REVERSED): Sensor.GYRO,
    (FERRARI, Fault.GYRO_FROZEN): Sensor.GYRO,
    (FERRARI, Fault.ACCEL_DEAD): Sensor.ACCELEROMETER,
    (FERRARI, Fault.ACCEL_SATURATED): Sensor.ACCELEROMETER,
    (FERRARI, Fault.STEERING_OFFSET_JUMP): Sensor.STEERING,
    (FERRARI, Fault.STEERING_FROZEN): Sensor.STEERING,
    (FERRARI, Fault.WHEEL_SLOW): None,  # its wheels are made of a reference speed
    (INDY, Fault.GYRO_DEAD): Sensor.GYRO,
    (INDY, Fault.GYRO_REVERSED): Sensor.GYRO,
    (INDY, Fault.GYRO_FROZEN): Sensor.GYRO,
    (INDY, Fault.STEERING_OFFSET_JUMP): Sensor.STEERING,
    (INDY, Fault.STEERING_FROZEN): Sensor.STEERING,
    (INDY, Fault.ACCEL_DEAD): None,  # it has no lateral accelerometer to begin with
    (MOTORWAY, Fault.GYRO_FROZEN): Sensor.GYRO,
    (MOTORWAY, Fault.ACCEL_SATURATED): Sensor.ACCELEROMETER,
    (MOTORWAY, Fault.STEERING_OFFSET_JUMP): Sensor.STEERING,
    (MOTORWAY, Fault.STEERING_FROZEN): None,  # on a motorway it hardly moves
}


def found_in(trace: Trace, name: str, *, from_s: float, to_s: float) -> tuple[Finding, ...]:
    trace = bridged(trace, believable(trace))
    vehicle = MAPPINGS[name].vehicle
    speed = unmapped_speed_mps(trace, vehicle=vehicle, parameters=XC90_PARAMETERS)
    return findings(trace, speed, from_s=from_s, to_s=to_s, vehicle=vehicle)


@pytest.mark.parametrize("name", [FERRARI, INDY, MOTORWAY])
def test_no_recorded_sensor_is_doubted(name):
    trace = recording(name).trace
    starts = np.arange(trace.time_s[0], trace.time_s[-1] - WINDOW_S, STEP_S)
    doubts = []
    for start_s in starts:
        part = part_of(trace, from_s=start_s - trace.time_s[0], to_s=start_s + WINDOW_S - trace.time_s[0])
        found = found_in(part, name, from_s=float(part.time_s[0]), to_s=float(part.time_s[-1]))
        doubts += [f"{start_s:.0f} s: {finding}" for finding in found if finding.doubtful]
    assert doubts == []


@pytest.mark.parametrize(("name", "fault"), SEEN, ids=lambda value: str(value)[:12])
def test_what_breaks_in_a_recording_is_blamed(name, fault):
    whole = recording(name).trace
    begin_s = IN_BENDS_S.get(name, 5.0)
    trace = part_of(whole, from_s=begin_s, to_s=begin_s + WINDOW_S)
    broken = with_fault(trace, fault, at_s=8.0)
    ends = {"from_s": float(trace.time_s[0]), "to_s": float(trace.time_s[-1])}
    blamed = {finding.sensor for finding in found_in(broken, name, **ends) if finding.grave}
    expected = SEEN[name, fault]
    assert blamed == (set() if expected is None else {expected})


def test_a_channel_that_the_recording_lacks_would_be_called_dead_if_it_were_not_said():
    trace = part_of(recording(INDY).trace, from_s=200.0, to_s=220.0)
    ends = {"from_s": float(trace.time_s[0]), "to_s": float(trace.time_s[-1])}
    assert "accel_y_mps2" in trace.absent
    unsaid = found_in(replace(trace, absent=()), INDY, **ends)
    assert Sensor.ACCELEROMETER in {finding.sensor for finding in unsaid if finding.grave}
