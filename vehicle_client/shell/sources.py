"""Recorded drives in and out: our own CSV, and recordings of others through a mapping of columns.

Our format is a CSV file, gzipped if its name ends in `.gz`, one row per sample, one header row with these names:

| column | what |
|---|---|
| `time_s` | monotonic clock; 100 rows a second, else the rows are resampled |
| `accel_x_mps2`, `accel_y_mps2` | specific force, forward and left |
| `roll_rate_radps`, `yaw_rate_radps` | left side up, left turn positive |
| `steer_rad` | mean angle of the front wheels, left positive |
| `wheel_front_left_mps` ... `wheel_rear_right_mps` | rotation times rolling radius |
| `stability_active` | optional: 1 while ABS, traction control or ESC intervene, else 0 |
| `gnss_time_s`, `lat_deg`, `lon_deg`, `gnss_accuracy_m` | optional: a position fix, in the row nearest to its time |
| `gnss_speed_mps` | optional: speed over ground of that fix |

Columns may come in any order; unknown ones are ignored. An empty cell in a sensor's column makes the row a missing
sample. `gnss_time_s` may be left out (the row's time is taken), and `gnss_accuracy_m` too (3 m).
"""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.records import QualityFlag
from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import WHEELS, GnssTrack, Trace, check_trace
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from roadgrip.units import BoolArray, FloatArray

SENSOR_COLUMNS = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad")
WHEEL_COLUMNS = tuple(f"wheel_{wheel}_mps" for wheel in WHEELS)
CHANNELS = SENSOR_COLUMNS + WHEEL_COLUMNS
GNSS_COLUMNS = ("gnss_time_s", "lat_deg", "lon_deg", "gnss_accuracy_m")
GNSS_SPEED_COLUMN = "gnss_speed_mps"
GNSS_ACCURACY_M = 3.0
DURATION_LIMIT_S = 4.0 * 3600.0
"""A longer recording, or a clock that jumps further, is refused instead of filling the memory."""
_ON_GRID_S = SAMPLE_S / 20.0
_GAP_STEPS_COUNT = 2.5
"""Rows farther apart than so many usual steps leave a gap between them."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Where a quantity comes from in somebody else's recording.

    Attributes:
        column: Name of the column.
        gain: Times this; -1 turns an axis round.
    """

    column: str
    gain: float = 1.0


@dataclass(frozen=True, slots=True)
class ColumnMapping:
    """How to read somebody else's recording.

    Attributes:
        time_column: Seconds.
        channels: Per name in `CHANNELS` where it comes from. What is missing reads zero, and `Recording.missing`
            says so; wheel speeds may be missing only if there is a reference speed.
        reference: Quantities of a reference instrument, under the names they get in `Recording.reference`.
        reference_speed: Name among them of the forward speed that stands in for the wheels; empty if they are there.
        vehicle: The car that was driven.
    """

    time_column: str
    channels: Mapping[str, Channel]
    reference: Mapping[str, Channel] = field(default_factory=dict)
    reference_speed: str = ""
    vehicle: VehicleGeometry = XC90


@dataclass(frozen=True, slots=True)
class Recording:
    """A drive somebody else recorded.

    Attributes:
        trace: The sensors.
        reference: What reference instruments saw, on the samples of the trace. Each (n,)
        missing: Channels that the recording lacks and that read zero in the trace, or come from a reference.
    """

    trace: Trace
    reference: Mapping[str, FloatArray]
    missing: tuple[str, ...]


def read_trace_csv(path: Path) -> Trace:
    """Return the trace of a file in our own format.

    Raises:
        TraceError: A column is missing, a cell is no number, time runs backwards; the message says where.
        OSError: The file cannot be read.
    """
    names, columns = _read_columns(path)
    absent = [name for name in ("time_s", *CHANNELS) if name not in names]
    if absent:
        message = f"{path.name}: no column {', '.join(absent)}"
        raise TraceError(message)
    time = columns["time_s"]
    values = np.column_stack([columns[name] for name in CHANNELS])
    active = columns.get("stability_active")
    return trace_of_samples(
        time,
        values,
        stability_active=None if active is None else np.nan_to_num(active) > 0.5,
        gnss=_gnss_of(columns, time),
    )


def write_trace_csv(path: Path, trace: Trace) -> None:
    """Write a trace in our own format; reading it back gives the same numbers to the last bit.

    Two fixes nearest to the same sample cannot both be kept; the later one is.

    Raises:
        OSError: The file cannot be written.
    """
    table: dict[str, Sequence[str]] = {"time_s": [repr(t) for t in trace.time_s.tolist()]}
    for name in SENSOR_COLUMNS:
        table[name] = _cells(getattr(trace, name), trace.valid)
    for i, name in enumerate(WHEEL_COLUMNS):
        table[name] = _cells(trace.wheel_speed_mps[:, i], trace.valid)
    if trace.stability_active is not None:
        table["stability_active"] = [str(int(flag)) for flag in trace.stability_active.tolist()]
    if trace.gnss is not None:
        table |= _gnss_cells(trace.gnss, trace.time_s)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*table.values(), strict=True))
    data = text.getvalue().encode()
    # Without a time stamp inside, the same trace gives the same file.
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)


def read_recording(path: Path, mapping: ColumnMapping) -> Recording:
    """Return a drive that somebody else recorded.

    Raises:
        TraceError: A column is missing, a cell is no number, time runs backwards; the message says where.
        OSError: The file cannot be read.
    """
    names, columns = _read_columns(path)
    wanted = [mapping.time_column, *(c.column for c in (*mapping.channels.values(), *mapping.reference.values()))]
    absent = sorted(set(wanted) - set(names))
    if absent:
        message = f"{path.name}: no column {', '.join(absent)}"
        raise TraceError(message)
    time = columns[mapping.time_column]
    rows = {name: columns[c.column] * c.gain for name, c in mapping.channels.items()}
    missing = tuple(name for name in CHANNELS if name not in rows)
    reference = {name: columns[c.column] * c.gain for name, c in mapping.reference.items()}
    quality = QualityFlag.NONE
    if mapping.reference_speed:
        yaw_rate, steer = (rows.get(name, np.zeros_like(time)) for name in ("yaw_rate_radps", "steer_rad"))
        rows |= _wheels_of_speed(reference[mapping.reference_speed], yaw_rate, steer, mapping)
        quality = QualityFlag.REFERENCE_SPEED
    elif set(WHEEL_COLUMNS) & set(missing):
        message = f"{path.name}: no wheel speeds, and no reference speed to stand in for them"
        raise TraceError(message)
    values = np.column_stack([rows.get(name, np.zeros_like(time)) for name in CHANNELS])
    trace = trace_of_samples(time, values, quality=quality)
    known = np.isfinite(time)
    return Recording(
        trace=trace,
        reference={name: np.interp(trace.time_s, time[known], of[known]) for name, of in reference.items()},
        missing=missing,
    )


def trace_of_samples(
    time_s: FloatArray,
    values: FloatArray,
    *,
    stability_active: BoolArray | None = None,
    gnss: GnssTrack | None = None,
    quality: QualityFlag = QualityFlag.NONE,
) -> Trace:
    """Return a trace of samples that came at any times, at 100 a second, with a mask where nothing came.

    Samples that lie on a 10 ms grid are kept as they are. Others are interpolated between neighbours that are no
    more than two and a half usual steps (and at least 25 ms) apart; in wider gaps samples are not valid.

    Args:
        time_s: Increasing. (k,)
        values: Columns as in `CHANNELS`; NaN where a sensor was silent. (k, 9)
        stability_active: At those times. (k,)
        gnss: Passed on.
        quality: Passed on.

    Raises:
        TraceError: Times are missing, run backwards or span more than four hours; there are fewer than two samples.
    """
    _check_times(time_s)
    whole: BoolArray = np.asarray(np.isfinite(values).all(axis=1))
    steps = np.diff(time_s)
    if np.abs(steps - SAMPLE_S).max() <= _ON_GRID_S:
        time, resampled, valid = time_s, np.where(whole[:, None], values, 0.0), whole
        active = stability_active
    else:
        count = int(np.floor((time_s[-1] - time_s[0]) / SAMPLE_S + 1e-6)) + 1
        time = time_s[0] + SAMPLE_S * np.arange(count)
        resampled, valid = _resampled(time, time_s, values, whole)
        nearest = np.clip(np.searchsorted(time_s, time), 0, len(time_s) - 1)
        active = None if stability_active is None else stability_active[nearest]
    trace = Trace(
        time_s=time,
        accel_x_mps2=resampled[:, 0],
        accel_y_mps2=resampled[:, 1],
        roll_rate_radps=resampled[:, 2],
        yaw_rate_radps=resampled[:, 3],
        steer_rad=resampled[:, 4],
        wheel_speed_mps=resampled[:, 5:9],
        valid=valid,
        stability_active=active,
        gnss=gnss,
        quality=quality,
    )
    check_trace(trace)
    return trace


def _check_times(time_s: FloatArray) -> None:
    if len(time_s) < 2 or not np.isfinite(time_s).all():
        message = "a recording needs at least two samples, each with its time"
        raise TraceError(message)
    back = np.flatnonzero(np.diff(time_s) <= 0.0)
    if len(back):
        message = f"time runs backwards or stands still after {time_s[back[0]]:.3f} s (row {int(back[0]) + 1})"
        raise TraceError(message)
    if time_s[-1] - time_s[0] > DURATION_LIMIT_S:
        message = f"the recording spans {time_s[-1] - time_s[0]:.0f} s, more than {DURATION_LIMIT_S:.0f}; cut it first"
        raise TraceError(message)


def _resampled(
    time_s: FloatArray, from_s: FloatArray, values: FloatArray, whole: BoolArray
) -> tuple[FloatArray, BoolArray]:
    if whole.sum() < 2:
        return np.zeros((len(time_s), values.shape[1])), np.zeros(len(time_s), dtype=bool)
    known = from_s[whole]
    limit = max(_GAP_STEPS_COUNT * SAMPLE_S, _GAP_STEPS_COUNT * float(np.median(np.diff(from_s))))
    after = np.clip(np.searchsorted(known, time_s - _ON_GRID_S), 1, len(known) - 1)
    apart = known[after] - known[after - 1]
    on_sample = np.minimum(np.abs(known[after] - time_s), np.abs(known[after - 1] - time_s)) <= SAMPLE_S / 2.0
    covered = (time_s >= known[0] - _ON_GRID_S) & (time_s <= known[-1] + _ON_GRID_S)
    columns = [np.interp(time_s, known, values[whole, i]) for i in range(values.shape[1])]
    return np.column_stack(columns), covered & ((apart <= limit) | on_sample)


def _wheels_of_speed(
    speed_mps: FloatArray, yaw_rate_radps: FloatArray, steer_rad: FloatArray, mapping: ColumnMapping
) -> dict[str, FloatArray]:
    """Return what four wheels that roll without slip would show at a forward speed, lateral velocity left out."""
    half = mapping.vehicle.track_m / 2.0
    across = yaw_rate_radps * mapping.vehicle.front_axle_m * np.sin(steer_rad)
    wheels = {}
    for name in WHEEL_COLUMNS:
        along = speed_mps - yaw_rate_radps * (half if "left" in name else -half)
        wheels[name] = along * np.cos(steer_rad) + across if "front" in name else along
    return wheels


def _read_columns(path: Path) -> tuple[list[str], dict[str, FloatArray]]:
    data = path.read_bytes()
    try:
        text = (gzip.decompress(data) if path.suffix == ".gz" else data).decode()
    except (UnicodeDecodeError, EOFError, zlib.error) as error:
        message = f"{path.name} is no CSV file: {error}"
        raise TraceError(message) from error
    rows = csv.reader(io.StringIO(text))
    names = [name.strip() for name in next(rows, [])]
    table = _numbers(rows, width=len(names), place=path.name)
    return names, {name: table[:, i] for i, name in enumerate(names)}


def _numbers(rows: Iterable[list[str]], *, width: int, place: str) -> FloatArray:
    numbers: list[list[float]] = []
    for line, row in enumerate(rows, start=2):
        if len(row) != width:
            message = f"{place}, line {line}: {len(row)} cells under {width} columns"
            raise TraceError(message)
        try:
            numbers.append([float(cell) if cell else np.nan for cell in row])
        except ValueError as error:
            message = f"{place}, line {line}: {error}"
            raise TraceError(message) from error
    return np.array(numbers, dtype=np.float64).reshape(len(numbers), width)


def _gnss_of(columns: Mapping[str, FloatArray], time_s: FloatArray) -> GnssTrack | None:
    if "lat_deg" not in columns or "lon_deg" not in columns:
        return None
    fixed = np.isfinite(columns["lat_deg"]) & np.isfinite(columns["lon_deg"])
    if not fixed.any():
        return None
    at = columns.get("gnss_time_s", time_s)[fixed]
    accuracy = columns.get("gnss_accuracy_m", np.full_like(time_s, GNSS_ACCURACY_M))[fixed]
    speed = columns.get(GNSS_SPEED_COLUMN)
    return GnssTrack(
        time_s=np.where(np.isfinite(at), at, time_s[fixed]),
        lat_deg=columns["lat_deg"][fixed],
        lon_deg=columns["lon_deg"][fixed],
        accuracy_m=np.where(np.isfinite(accuracy), accuracy, GNSS_ACCURACY_M),
        speed_mps=None if speed is None else speed[fixed],
    )


def _cells(values: FloatArray, valid: BoolArray) -> list[str]:
    return [repr(v) if ok else "" for v, ok in zip(values.tolist(), valid.tolist(), strict=True)]


def _gnss_cells(gnss: GnssTrack, time_s: FloatArray) -> dict[str, Sequence[str]]:
    row = np.clip(np.rint((gnss.time_s - time_s[0]) / SAMPLE_S).astype(int), 0, len(time_s) - 1)
    columns = dict(zip(GNSS_COLUMNS, (gnss.time_s, gnss.lat_deg, gnss.lon_deg, gnss.accuracy_m), strict=True))
    if gnss.speed_mps is not None:
        columns[GNSS_SPEED_COLUMN] = gnss.speed_mps
    table: dict[str, Sequence[str]] = {}
    for name, values in columns.items():
        cells = [""] * len(time_s)
        for k, value in zip(row.tolist(), values.tolist(), strict=True):
            cells[k] = repr(value)
        table[name] = cells
    return table


_WHEELS_FL_FR_RL_RR = {
    name: Channel(column)
    for name, column in zip(
        WHEEL_COLUMNS, ("wheel_fl_mps", "wheel_fr_mps", "wheel_rl_mps", "wheel_rr_mps"), strict=True
    )
}

FERRARI_250LM = ColumnMapping(
    time_column="t_s",
    channels={
        "accel_x_mps2": Channel("ax"),
        "accel_y_mps2": Channel("ay"),
        "yaw_rate_radps": Channel("yaw_rate"),
        "steer_rad": Channel("delta"),
    },
    reference={
        "velocity_x_mps": Channel("vx_ref"),
        "velocity_y_mps": Channel("vy_ref"),
        "sideslip_rad": Channel("beta_ref"),
    },
    reference_speed="velocity_x_mps",
    vehicle=VehicleGeometry(wheelbase_m=2.40, track_m=1.35, front_axle_m=1.34),
)
"""A 1965 racing car of the Stanford Revs Program; no wheel speeds and no roll rate. Its wheelbase is the maker's; the
centre of gravity of the mid-engined car is an estimate."""

IAC_AV21 = ColumnMapping(
    time_column="t_s",
    channels={
        "accel_x_mps2": Channel("ax"),
        "yaw_rate_radps": Channel("yaw_rate"),
        "steer_rad": Channel("delta"),
        **_WHEELS_FL_FR_RL_RR,
    },
    reference={"velocity_x_mps": Channel("vx_ref"), "velocity_y_mps": Channel("vy_ref")},
    vehicle=VehicleGeometry(wheelbase_m=2.97, track_m=1.6, front_axle_m=1.72),
)
"""The racing car of the Indy Autonomous Challenge; 25 rows a second, no lateral accelerometer and no roll rate."""

_RAV4_STEERING_RATIO = 16.9

COMMA2K19_RAV4 = ColumnMapping(
    time_column="t_s",
    channels={
        "accel_x_mps2": Channel("imu_fwd"),
        "accel_y_mps2": Channel("imu_right", gain=-1.0),
        "roll_rate_radps": Channel("gyro_fwd"),
        "yaw_rate_radps": Channel("gyro_down", gain=-1.0),
        "steer_rad": Channel("steer_wheel_deg", gain=float(np.deg2rad(1.0)) / _RAV4_STEERING_RATIO),
        **_WHEELS_FL_FR_RL_RR,
    },
    reference={
        "velocity_x_mps": Channel("v_fwd_ref"),
        "velocity_y_mps": Channel("v_right_ref", gain=-1.0),
        "imu_up_mps2": Channel("imu_down", gain=-1.0),
    },
    vehicle=VehicleGeometry(wheelbase_m=2.66, track_m=1.57, front_axle_m=1.20),
)
"""A production car on a motorway; axes forward, right, down turned to forward, left, up."""
