"""The record of one drive as the vehicle's own sensors saw it, 100 samples a second."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.records import QualityFlag
from roadgrip.units import SAMPLE_S

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
"""Order of every array with one column per wheel."""


@dataclass(frozen=True, slots=True)
class GnssTrack:
    """Position fixes in the order of time; gaps are simply absent rows. All arrays (k,).

    Attributes:
        time_s: On the clock of the trace.
        lat_deg: WGS 84.
        lon_deg: WGS 84.
        accuracy_m: One standard deviation of the horizontal position, as the receiver says.
        speed_mps: Over ground, from the Doppler shift, if the receiver tells it.
    """

    time_s: FloatArray
    lat_deg: FloatArray
    lon_deg: FloatArray
    accuracy_m: FloatArray
    speed_mps: FloatArray | None = None

    def where(self, kept: BoolArray) -> GnssTrack:
        """Return the fixes of a mask. (k,)"""
        speed = None if self.speed_mps is None else self.speed_mps[kept]
        return GnssTrack(
            self.time_s[kept], self.lat_deg[kept], self.lon_deg[kept], self.accuracy_m[kept], speed_mps=speed
        )


@dataclass(frozen=True, slots=True)
class Trace:
    """Consecutive samples of one vehicle, approach and exit included; ISO 8855 axes (x forward, y left, z up).

    Accelerations are what an accelerometer measures (specific force): on a bank or with a rolled body they hold a
    part of gravity. All arrays (n,) unless said.

    Attributes:
        time_s: Monotonic clock of the vehicle, every 10 ms.
        accel_x_mps2: Forward.
        accel_y_mps2: Left.
        roll_rate_radps: Left side up positive.
        yaw_rate_radps: Left turn positive.
        steer_rad: Mean angle of the front wheels, left positive.
        wheel_speed_mps: Rotation times nominal rolling radius, columns as in `WHEELS`. (n, 4)
        valid: False where a sample is missing; its values then do not matter.
        stability_active: True while ABS, traction control or ESC intervene, where the vehicle reports it.
        gnss: Position fixes, if the vehicle has any.
        quality: What is known about the recording beforehand, such as a speed that comes from a reference instrument.
        absent: Names of the channels that the car or the recording lacks, such as `roll_rate_radps`; they read zero, or
            are made of others. Nobody calls them faulty.
    """

    time_s: FloatArray
    accel_x_mps2: FloatArray
    accel_y_mps2: FloatArray
    roll_rate_radps: FloatArray
    yaw_rate_radps: FloatArray
    steer_rad: FloatArray
    wheel_speed_mps: FloatArray
    valid: BoolArray
    stability_active: BoolArray | None = None
    gnss: GnssTrack | None = None
    quality: QualityFlag = QualityFlag.NONE
    absent: tuple[str, ...] = ()

    @property
    def samples_count(self) -> int:
        """Number of samples."""
        return len(self.time_s)


def check_trace(trace: Trace) -> None:
    """Do nothing if the arrays of a trace fit each other.

    Raises:
        TraceError: Lengths differ, samples are not 10 ms apart, or a valid sample is not finite.
    """
    n = trace.samples_count
    for name, mask in (("valid", trace.valid), ("stability_active", trace.stability_active)):
        if mask is not None and mask.shape != (n,):
            message = f"{name} has shape {mask.shape}, the trace has {n} samples"
            raise TraceError(message)
    columns = {
        "accel_x_mps2": trace.accel_x_mps2,
        "accel_y_mps2": trace.accel_y_mps2,
        "roll_rate_radps": trace.roll_rate_radps,
        "yaw_rate_radps": trace.yaw_rate_radps,
        "steer_rad": trace.steer_rad,
    }
    for name, values in columns.items():
        if values.shape != (n,):
            message = f"{name} has shape {values.shape}, the trace has {n} samples"
            raise TraceError(message)
        if not np.isfinite(values[trace.valid]).all():
            message = f"{name} is not finite in a sample that is said to be valid"
            raise TraceError(message)
    if trace.wheel_speed_mps.shape != (n, 4) or not np.isfinite(trace.wheel_speed_mps[trace.valid]).all():
        message = f"wheel_speed_mps must be ({n}, 4) and finite in valid samples, is {trace.wheel_speed_mps.shape}"
        raise TraceError(message)
    # Times that are not finite fail the comparison.
    if n > 1 and not np.abs(np.diff(trace.time_s) - SAMPLE_S).max() <= SAMPLE_S / 10.0:
        message = "samples are not 10 ms apart; resample the recording first"
        raise TraceError(message)


def part_of(trace: Trace, *, from_s: float, to_s: float) -> Trace:
    """Return the samples and fixes of a trace between two times, counted from its first sample.

    Args:
        trace: The whole.
        from_s: First time that is kept.
        to_s: Last time that is kept.

    Raises:
        TraceError: Nothing lies between them.
    """
    since_s = trace.time_s - trace.time_s[0]
    inside = (since_s > from_s - SAMPLE_S / 2.0) & (since_s < to_s + SAMPLE_S / 2.0)
    if not inside.any():
        message = f"the recording lasts {since_s[-1]:.1f} s; nothing lies between {from_s} and {to_s} s"
        raise TraceError(message)
    gnss = trace.gnss
    if gnss is not None:
        kept = (gnss.time_s >= trace.time_s[inside][0]) & (gnss.time_s <= trace.time_s[inside][-1])
        gnss = gnss.where(kept)
    return replace(
        trace,
        time_s=trace.time_s[inside],
        accel_x_mps2=trace.accel_x_mps2[inside],
        accel_y_mps2=trace.accel_y_mps2[inside],
        roll_rate_radps=trace.roll_rate_radps[inside],
        yaw_rate_radps=trace.yaw_rate_radps[inside],
        steer_rad=trace.steer_rad[inside],
        wheel_speed_mps=trace.wheel_speed_mps[inside],
        valid=trace.valid[inside],
        stability_active=None if trace.stability_active is None else trace.stability_active[inside],
        gnss=gnss,
    )


def mirrored(trace: Trace) -> Trace:
    """Return the trace a vehicle would record on the road seen in a mirror (left and right exchanged).

    Positions are left out, since a mirrored road lies elsewhere.
    """
    return Trace(
        time_s=trace.time_s,
        accel_x_mps2=trace.accel_x_mps2,
        accel_y_mps2=-trace.accel_y_mps2,
        roll_rate_radps=-trace.roll_rate_radps,
        yaw_rate_radps=-trace.yaw_rate_radps,
        steer_rad=-trace.steer_rad,
        wheel_speed_mps=trace.wheel_speed_mps[:, [1, 0, 3, 2]],
        valid=trace.valid,
        stability_active=trace.stability_active,
        gnss=None,
        quality=trace.quality,
        absent=trace.absent,
    )
