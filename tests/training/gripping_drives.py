"""Made-up drives of a car whose rear tyres slip by a known gradient: the best constants of such a car are known."""

import numpy as np

from roadgrip.units import SAMPLE_S, FloatArray
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.recording.csv_table import csv_of_columns
from vehicle_client.recording.foreign import Recording
from vehicle_client.recording.own_columns import columns_of_trace

SPEED_MPS = 20.0


def gripping_recording(*, slip_gradient_s2pm: float, duration_s: float = 60.0) -> Recording:
    """Return a drive at constant speed through gentle bends to either side, exact sensors, no roll, level road."""
    time_s: FloatArray = SAMPLE_S * np.arange(round(duration_s / SAMPLE_S), dtype=np.float64)
    # V_y = b r - D V a_y with a_y = r V + dV_y/dt, solved for each sine of the yaw rate.
    lag_s = slip_gradient_s2pm * SPEED_MPS
    yaw_rate, velocity_y, accel_y = np.zeros((3, len(time_s)))
    for amplitude_radps, period_s in ((0.06, 14.0), (0.04, 5.0)):
        w = 2.0 * np.pi / period_s
        gain_mps = amplitude_radps * (XC90.rear_axle_m - lag_s * SPEED_MPS) / (1.0 + (w * lag_s) ** 2)
        sine, cosine = np.sin(w * time_s), np.cos(w * time_s)
        yaw_rate += amplitude_radps * sine
        velocity_y += gain_mps * (sine - w * lag_s * cosine)
        accel_y += amplitude_radps * sine * SPEED_MPS + gain_mps * w * (cosine + w * lag_s * sine)
    steer = yaw_rate * XC90.wheelbase_m / SPEED_MPS
    half_track = XC90.track_m / 2.0
    across = (velocity_y + yaw_rate * XC90.front_axle_m) * np.sin(steer)
    left, right = SPEED_MPS - yaw_rate * half_track, SPEED_MPS + yaw_rate * half_track
    wheels = [left * np.cos(steer) + across, right * np.cos(steer) + across, left, right]
    trace = Trace(
        time_s=time_s,
        accel_x_mps2=-yaw_rate * velocity_y,
        accel_y_mps2=accel_y,
        roll_rate_radps=np.zeros_like(time_s),
        yaw_rate_radps=yaw_rate,
        steer_rad=steer,
        wheel_speed_mps=np.column_stack(wheels),
        valid=np.ones(len(time_s), dtype=bool),
    )
    reference = {"velocity_x_mps": np.full_like(time_s, SPEED_MPS), "velocity_y_mps": velocity_y}
    return Recording(trace=trace, reference=reference, missing=())


def reference_csv(recording: Recording, **changed: FloatArray) -> bytes:
    """Return a recording as a file in our own format with reference columns."""
    columns = columns_of_trace(recording.trace)
    columns |= {f"reference_{name}": values for name, values in recording.reference.items()}
    return csv_of_columns(columns | changed)
