"""Drives whose true sideslip is known, recorded or simulated, made ready to be estimated with any constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import count, islice

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.records import Rejected
from roadgrip.section import RoadSection, build_section
from roadgrip.units import SAMPLE_S, BoolArray, FloatArray
from training.scenarios import ATTEMPTS_PER_KEPT_RUN_COUNT, Scenario, Terms, kept, run_of, surveyed_map
from vehicle_client.estimation.gaps import believable, bridged
from vehicle_client.estimation.mounting import in_car_axes
from vehicle_client.estimation.offsets import NO_OFFSETS, SensorOffsets
from vehicle_client.estimation.trace import Trace, part_of
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.pipeline import summarise_passage
from vehicle_client.recording.csv_table import columns_of_csv
from vehicle_client.recording.foreign import ColumnMapping, Recording, recording_of_columns
from vehicle_client.recording.own_columns import trace_of_columns
from vehicle_client.recording.public import COMMA2K19_RAV4, FERRARI_250LM, IAC_AV21
from vehicle_client.simulator.run import each_passage

REFERENCE_COLUMNS = ("reference_velocity_x_mps", "reference_velocity_y_mps")
"""What a recording in our own format holds besides the sensors' columns to be tuned on: the velocities of the centre of
gravity, forward and left, as a reference instrument tells them; an empty cell where it was silent."""
MOVING_MPS = 5.0
"""Slower, the sideslip of a reference instrument is mostly its noise."""
EDGE_S = 3.0
"""At either end of a part of a recording nothing is judged: filters lean on what is beyond, the observer has yet to
forget where it started."""
SHORTEST_PART_S = 20.0
_OPEN_SECONDS_COUNT = int(EDGE_S / SAMPLE_S)


class ReferenceFormat(StrEnum):
    """Whose recording it is."""

    ROADGRIP = "roadgrip"
    """Our own CSV with `REFERENCE_COLUMNS`."""
    FERRARI_250LM = "ferrari-250lm"
    IAC_AV21 = "iac-av21"
    COMMA2K19_RAV4 = "comma2k19-rav4"


MAPPINGS: Mapping[ReferenceFormat, ColumnMapping] = {
    ReferenceFormat.FERRARI_250LM: FERRARI_250LM,
    ReferenceFormat.IAC_AV21: IAC_AV21,
    ReferenceFormat.COMMA2K19_RAV4: COMMA2K19_RAV4,
}


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceDrive:
    """One drive and its true sideslip, all arrays on the samples of the trace.

    Attributes:
        name: What people call it.
        trace: What the sensors saw, gaps bridged, in the car's axes.
        section: The map the vehicle had; level where nobody knows better.
        station_m: Where along it. (n,)
        vehicle: The car.
        offsets: What the vehicle subtracts from its sensors.
        sideslip_rad: True, left positive; any number where it is not judged. (n,)
        judged: Which samples an estimate is judged on. (n,)
    """

    name: str
    trace: Trace
    section: RoadSection
    station_m: FloatArray
    vehicle: VehicleGeometry
    offsets: SensorOffsets
    sideslip_rad: FloatArray
    judged: BoolArray

    @property
    def judged_s(self) -> float:
        """How long it is judged."""
        return float(np.count_nonzero(self.judged)) * SAMPLE_S


def level_road() -> RoadSection:
    """Return a map that says nothing: straight, without bank and grade."""
    nodes_m = np.column_stack([np.linspace(0.0, 200.0, 11), np.zeros(11), np.zeros(11)])
    return build_section(section_id="level", name="A level road", nodes_m=nodes_m, speed_limit_mps=30.0)


def recording_with_reference(data: bytes, recorded_as: ReferenceFormat, *, place: str) -> Recording:
    """Return a recording whose reference holds both velocities, as `velocity_x_mps` and `velocity_y_mps`.

    Args:
        data: The file's bytes, CSV, gzipped or not.
        recorded_as: Whose columns they are.
        place: What the file is called, for messages.

    Raises:
        TraceError: It is no such recording, or has no reference; the message says what is missing.
    """
    columns = columns_of_csv(data, place=place)
    if recorded_as is not ReferenceFormat.ROADGRIP:
        found = recording_of_columns(columns, MAPPINGS[recorded_as], place=place)
    else:
        absent = [name for name in REFERENCE_COLUMNS if name not in columns]
        if absent:
            raise TraceError(f"{place}: no column {', '.join(absent)}; without a reference there is nothing to tune to")
        trace = trace_of_columns(columns, place=place)
        time_s = columns["time_s"]
        reference = {
            name.removeprefix("reference_"): _on_samples(trace.time_s, time_s, columns[name])
            for name in REFERENCE_COLUMNS
        }
        found = Recording(trace=trace, reference=reference, missing=())
    if "accel_y_mps2" in found.missing:
        raise TraceError(f"{place}: there is no lateral accelerometer in it, and without one no sideslip is estimated")
    return found


def parts_of_recording(
    recording: Recording, *, name: str, vehicle: VehicleGeometry, tuned_frac: float
) -> tuple[ReferenceDrive, ReferenceDrive | None]:
    """Return the first part of a recording and the rest, each estimated by itself; None where no rest is asked for.

    The road is taken as level, since nobody knows it; sensor offsets are not estimated, since a recording need not
    begin on a straight: the roll filter takes a steady one out.

    Args:
        recording: With both velocities in its reference.
        name: What people call it.
        vehicle: The car.
        tuned_frac: Share of the time that the first part takes.

    Raises:
        TraceError: A part is shorter than 20 s, or the car never drives faster than 5 m/s in it.
    """
    spans_s = SAMPLE_S * (recording.trace.samples_count - 1)
    first = _part(recording, name=name, vehicle=vehicle, from_s=0.0, to_s=tuned_frac * spans_s)
    if tuned_frac >= 1.0:
        return first, None
    return first, _part(recording, name=name, vehicle=vehicle, from_s=tuned_frac * spans_s + SAMPLE_S, to_s=spans_s)


def simulated_drives(
    section: RoadSection, terms: Terms, *, base_friction_mu: float, drives_count: int, vehicle: VehicleGeometry
) -> list[ReferenceDrive]:
    """Return so many simulated drives that came through and were recognised, or what twenty times as many gave.

    Args:
        section: The road.
        terms: Seed, sensors and drivers.
        base_friction_mu: What the road offers a new tyre.
        drives_count: How many are wanted.
        vehicle: What the onboard client takes the car for.
    """
    scenario = Scenario(section.section_id, section, kept(drives_count))
    road_map = surveyed_map(terms, section)
    runs = [
        run_of(terms, scenario, base_friction_mu=base_friction_mu, number=number)
        for number in islice(count(), ATTEMPTS_PER_KEPT_RUN_COUNT * drives_count)
    ]
    found: list[ReferenceDrive] = []
    for run, drive in zip(runs, each_passage(section, (run.plan for run in runs)), strict=True):
        if not drive.completed:
            continue
        result = summarise_passage(drive.trace, road_map, vehicle=vehicle)
        if isinstance(result, Rejected):
            continue
        valid = believable(drive.trace)
        found.append(
            ReferenceDrive(
                name=run.key,
                trace=in_car_axes(bridged(drive.trace, valid), vehicle),
                section=road_map,
                station_m=result.match.station_m,
                vehicle=vehicle,
                offsets=result.offsets,
                sideslip_rad=drive.truth.sideslip_rad,
                judged=valid & result.match.inside(drive.trace.time_s),
            )
        )
        if len(found) == drives_count:
            break
    return found


def _part(recording: Recording, *, name: str, vehicle: VehicleGeometry, from_s: float, to_s: float) -> ReferenceDrive:
    whole = recording.trace
    trace = part_of(whole, from_s=from_s, to_s=to_s)
    n = trace.samples_count
    first = int(np.searchsorted(whole.time_s, trace.time_s[0] - SAMPLE_S / 2.0))
    velocity_x, velocity_y = (
        recording.reference[key][first : first + n] for key in ("velocity_x_mps", "velocity_y_mps")
    )
    if n * SAMPLE_S < SHORTEST_PART_S:
        raise TraceError(
            f"{name}: a part of {n * SAMPLE_S:.0f} s is too short to judge; {SHORTEST_PART_S:.0f} s are needed"
        )
    valid = believable(trace)
    known = np.isfinite(velocity_x) & np.isfinite(velocity_y)
    judged = valid & known & (np.where(known, velocity_x, 0.0) > MOVING_MPS)
    judged[:_OPEN_SECONDS_COUNT] = judged[-_OPEN_SECONDS_COUNT:] = False
    if not judged.any():
        raise TraceError(
            f"{name}: the reference is never faster than {MOVING_MPS:.0f} m/s between {from_s:.0f} and {to_s:.0f} s"
        )
    return ReferenceDrive(
        name=name,
        trace=in_car_axes(bridged(trace, valid), vehicle),
        section=level_road(),
        station_m=np.zeros(n),
        vehicle=vehicle,
        offsets=NO_OFFSETS,
        sideslip_rad=np.where(known, np.arctan2(np.nan_to_num(velocity_y), np.nan_to_num(velocity_x)), 0.0),
        judged=judged,
    )


def _on_samples(time_s: FloatArray, from_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return a reference on the samples of the trace; NaN where it was silent."""
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(time_s), np.nan)
    told = np.interp(time_s, from_s, known.astype(np.float64)) > 1.0 - 1e-6
    return np.where(told, np.interp(time_s, from_s[known], values[known]), np.nan)
