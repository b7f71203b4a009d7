"""The sideslip of a recorded racing car against its reference instrument, and what makes the estimate better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.onboard.laps import bank_of_other_laps_rad, gravity_by_reference_mps2, laps_of, repeats_correlation
from bench.onboard.variants import with_widths
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S, BoolArray, FloatArray
from training.observer_tuning import best_parameters, estimated_sideslip_rad, usual_constants
from training.reference_drives import MOVING_MPS, ReferenceDrive, level_road, parts_of_recording
from vehicle_client.estimation.filters import slow_part, smoothed
from vehicle_client.estimation.observer import (
    PAPER_PARAMETERS,
    XC90_PARAMETERS,
    ObserverParameters,
    gripping_velocity_y_mps,
    sideslip_rad,
)
from vehicle_client.estimation.offsets import NO_OFFSETS, SensorOffsets, sensor_offsets
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.recording.foreign import Recording

TUNED_FRAC = 0.5
EVALUATIONS_COUNT = 600
EVALUATIONS_OF_FEW_COUNT = 150
SEED = 1
CAUSAL_EVERY_S = 25.0
"""How often a car that estimates as it goes looks at the straights behind it."""
SLOW_CROSSOVER_HZ = 0.02
OF_THE_BODY = ("rear_slip_gradient_s2pm", "roll_gradient_s2pm", "roll_crossover_hz")
"""Constants that a person could measure on the car, unlike those of the observer."""
SLIP_GRADIENTS_S2PM = np.arange(0.002, 0.01201, 0.00025)
PULLS = {"to_zero": PAPER_PARAMETERS, "to_gripping_car": XC90_PARAMETERS}
SMALL, LARGE = 1e-6, 1e6
"""Factors on the widths of F that make it zero in motion, and one."""


@dataclass(frozen=True, slots=True)
class Racing:
    """The recording with all that its variants share. Arrays (n,).

    Attributes:
        recording: Sensors and reference.
        vehicle: The car.
        truth_rad: Sideslip of the reference.
        moving: Where the reference is faster than 5 m/s.
        later: The part that nothing was fitted to.
    """

    recording: Recording
    vehicle: VehicleGeometry
    truth_rad: FloatArray
    moving: BoolArray
    later: BoolArray

    def estimate_rad(
        self,
        parameters: ObserverParameters,
        *,
        accel_y_mps2: FloatArray | None = None,
        offsets: SensorOffsets = NO_OFFSETS,
    ) -> FloatArray:
        """Return what the onboard estimation makes of it on a level map."""
        trace = self.recording.trace
        if accel_y_mps2 is not None:
            trace = replace(trace, accel_y_mps2=accel_y_mps2)
        n = trace.samples_count
        whole = ReferenceDrive(
            name="",
            trace=trace,
            section=level_road(),
            station_m=np.zeros(n),
            vehicle=self.vehicle,
            offsets=offsets,
            sideslip_rad=self.truth_rad,
            judged=self.moving,
        )
        return estimated_sideslip_rad(whole, parameters)

    def judged(self, estimate_rad: FloatArray) -> dict[str, float]:
        """Return error, correlation and gain of an estimate over the whole, and the error where nothing was fitted."""
        found, truth = estimate_rad[self.moving], self.truth_rad[self.moving]
        unseen = self.moving & self.later
        return {
            "rms_error_rad": rms(found - truth),
            "correlation_ratio": correlation(found, truth),
            "gain_ratio": float(found @ truth / (truth @ truth)),
            "rms_error_second_half_rad": rms(estimate_rad[unseen] - self.truth_rad[unseen]),
        }


def rms(values: FloatArray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def correlation(one: FloatArray, other: FloatArray) -> float:
    """Return the correlation; zero where either is constant."""
    return float(np.corrcoef(one, other)[0, 1]) if min(float(np.std(one)), float(np.std(other))) > 0.0 else 0.0


def racing_of(recording: Recording, vehicle: VehicleGeometry) -> Racing:
    """Return the recording of a racing car, made ready."""
    n = recording.trace.samples_count
    return Racing(
        recording=recording,
        vehicle=vehicle,
        truth_rad=recording.reference["sideslip_rad"],
        moving=recording.trace.valid & (recording.reference["velocity_x_mps"] > MOVING_MPS),
        later=np.arange(n) >= TUNED_FRAC * n,
    )


def by_pull(racing: Racing) -> dict[str, Any]:
    """Return how well F = 0, our F and F = 1 do, for either velocity that F pulls to, and claiming none."""
    rows = {"none": racing.judged(np.zeros_like(racing.truth_rad))}
    for name, parameters in PULLS.items():
        rows[f"f_one_{name}"] = racing.judged(racing.estimate_rad(with_widths(parameters, LARGE)))
        rows[f"our_f_{name}"] = racing.judged(racing.estimate_rad(parameters))
        rows[f"f_zero_{name}"] = racing.judged(racing.estimate_rad(with_widths(parameters, SMALL)))
    trace, speed = racing.recording.trace, racing.recording.reference["velocity_x_mps"]

    def gripping_rad(parameters: ObserverParameters) -> FloatArray:
        gripping = gripping_velocity_y_mps(
            smoothed(trace.accel_y_mps2),
            trace.yaw_rate_radps,
            speed,
            rear_axle_m=racing.vehicle.rear_axle_m,
            parameters=parameters,
        )
        return sideslip_rad(speed, gripping)

    first = racing.moving & ~racing.later
    fitted = min(
        (replace(XC90_PARAMETERS, rear_slip_gradient_s2pm=float(gradient)) for gradient in SLIP_GRADIENTS_S2PM),
        key=lambda parameters: rms((gripping_rad(parameters) - racing.truth_rad)[first]),
    )
    rows["gripping_car_alone"] = racing.judged(gripping_rad(XC90_PARAMETERS))
    rows["gripping_car_alone_fitted"] = racing.judged(gripping_rad(fitted)) | {
        "rear_slip_gradient_s2pm": fitted.rear_slip_gradient_s2pm
    }
    rows["our_f_to_fitted_gripping_car"] = racing.judged(racing.estimate_rad(fitted))
    return rows


def improvements(racing: Racing) -> tuple[dict[str, Any], ObserverParameters]:
    """Return what each improvement does, with the evidence for it, and the constants recalibrated for the vehicle."""
    trace, reference = racing.recording.trace, racing.recording.reference
    accel_y, yaw_rate = trace.accel_y_mps2, trace.yaw_rate_radps
    speed, velocity_y = reference["velocity_x_mps"], reference["velocity_y_mps"]
    first = racing.moving & ~racing.later
    laps = laps_of(speed, yaw_rate)
    gravity = gravity_by_reference_mps2(accel_y, yaw_rate, speed, velocity_y)
    force = smoothed(accel_y)
    roll_gain, told_offset = (float(told) for told in np.polyfit(force[first], gravity[first], 1))
    roll_gradient = roll_gain / GRAVITY_MPS2
    bank = bank_of_other_laps_rad(gravity - roll_gain * force, laps)
    own_bank = bank_of_other_laps_rad(force - smoothed(yaw_rate * speed), laps)
    causal_yaw_rate, causal_accel_y = causal_offsets(racing)
    straights = offsets_of_straights(racing)
    so_far = replace(trace, accel_y_mps2=accel_y - causal_accel_y, yaw_rate_radps=yaw_rate - causal_yaw_rate)
    causal = replace(racing, recording=replace(racing.recording, trace=so_far))

    def row(
        parameters: ObserverParameters, *, bank_rad: FloatArray | None = None, offsets: SensorOffsets = NO_OFFSETS
    ) -> Any:
        levelled = None if bank_rad is None else accel_y - GRAVITY_MPS2 * np.sin(bank_rad)
        return racing.judged(racing.estimate_rad(parameters, accel_y_mps2=levelled, offsets=offsets))

    rows: dict[str, Any] = {}
    found: dict[str, ObserverParameters] = {}
    for name, parameters in PULLS.items():
        rolling = replace(parameters, roll_gradient_s2pm=roll_gradient)
        slow = replace(rolling, roll_crossover_hz=SLOW_CROSSOVER_HZ)
        of_body = [constant for constant in OF_THE_BODY if _moves(constant, parameters)]
        found[name] = recalibrated_parameters(
            racing, parameters, [c for c in usual_constants() if _moves(c, parameters)]
        )
        rows[name] = {
            "before": row(parameters),
            "offsets_causal": causal.judged(causal.estimate_rad(parameters)),
            "offsets_whole_recording": row(parameters, offsets=straights),
            "offset_by_reference": row(parameters, offsets=replace(NO_OFFSETS, accel_y_mps2=told_offset)),
            "no_roll_gradient": row(replace(parameters, roll_gradient_s2pm=0.0)),
            "roll_gradient": row(rolling),
            "roll_gradient_slow_crossover": row(slow),
            "bank_own_sensors": row(slow, bank_rad=own_bank),
            "bank": row(rolling, bank_rad=bank),
            "bank_slow_crossover": row(slow, bank_rad=bank),
            "recalibrated_body": row(
                recalibrated_parameters(racing, parameters, of_body, evaluations_count=EVALUATIONS_OF_FEW_COUNT)
            ),
            "recalibrated": row(found[name]),
        }
    recalibrated = found["to_gripping_car"]
    left_over = gravity - roll_gain * force - GRAVITY_MPS2 * np.sin(bank)
    evidence = {
        "laps_count": laps.laps_count,
        "lap_m": laps.lap_m,
        "gravity_std_mps2": float(np.std(gravity[racing.moving])),
        "gravity_slower_than_tenth_hz_std_mps2": float(np.std(slow_part(gravity, crossover_hz=0.1)[racing.moving])),
        "gravity_less_roll_and_bank_std_mps2": float(np.std(left_over[racing.moving])),
        "gravity_repeats_next_lap_correlation_ratio": repeats_correlation(
            slow_part(gravity, crossover_hz=0.5), laps, speed
        ),
        "sideslip_repeats_next_lap_correlation_ratio": repeats_correlation(racing.truth_rad, laps, speed),
        "bank_largest_rad": float(np.abs(bank).max()),
        "roll_gradient_by_reference_s2pm": roll_gradient,
        "offset_by_reference_mps2": told_offset,
        "offset_of_straights_mps2": straights.accel_y_mps2,
        "offset_of_straights_std_mps2": straights.accel_y_std_mps2,
        "longest_straight_s": straights.straight_s,
    }
    constants = {
        name: {"before": getattr(XC90_PARAMETERS, name), "after": getattr(recalibrated, name)}
        for name in usual_constants()
    }
    return {"rows": rows, "evidence": evidence, "recalibrated_constants": constants}, recalibrated


def recalibrated_parameters(
    racing: Racing,
    start: ObserverParameters,
    constants: Sequence[str],
    *,
    evaluations_count: int = EVALUATIONS_COUNT,
) -> ObserverParameters:
    """Return what the tuner finds on the first half, as `roadgrip-train tune-observer` does."""
    part, _ = parts_of_recording(racing.recording, name="first half", vehicle=racing.vehicle, tuned_frac=TUNED_FRAC)
    return best_parameters(
        [part], start, constants=constants, evaluations_limit_count=evaluations_count, seed=SEED
    ).parameters


def _moves(constant: str, parameters: ObserverParameters) -> bool:
    """Return whether a constant changes anything: pulled to zero, the gripping car's do not."""
    return parameters.grip_pull_ratio > 0.0 or constant not in {"rear_slip_gradient_s2pm", "grip_pull_ratio"}


def offsets_of_straights(racing: Racing, *, until: int | None = None) -> SensorOffsets:
    """Return what the longest straight tells of the offsets, as the client estimates it on an approach.

    Args:
        racing: The recording.
        until: Samples from which on nothing is known yet; the whole recording if None.
    """
    trace = racing.recording.trace
    behind = np.arange(trace.samples_count) < (trace.samples_count if until is None else until)
    return sensor_offsets(
        trace.accel_y_mps2,
        trace.yaw_rate_radps,
        trace.steer_rad,
        racing.recording.reference["velocity_x_mps"],
        racing.moving & behind,
        accel_x_mps2=trace.accel_x_mps2,
        climb_rad=0.0,
        wheelbase_m=racing.vehicle.wheelbase_m,
    )


def causal_offsets(racing: Racing) -> tuple[FloatArray, FloatArray]:
    """Return yaw rate and lateral acceleration to subtract, each as the straights so far tell. Both (n,)"""
    n = racing.recording.trace.samples_count
    yaw_rate, accel_y = np.zeros(n), np.zeros(n)
    every = int(CAUSAL_EVERY_S / SAMPLE_S)
    for begin in range(every, n, every):
        known = offsets_of_straights(racing, until=begin)
        yaw_rate[begin : begin + every], accel_y[begin : begin + every] = known.yaw_rate_radps, known.accel_y_mps2
    return yaw_rate, accel_y
