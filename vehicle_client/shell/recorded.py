"""A recorded drive and the car that drove it, whatever file it is kept in."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError
from vehicle_client.mapmatch.driven_line import DrivenLine, driven_line
from vehicle_client.recording.foreign import Recording
from vehicle_client.recording.own_columns import trace_of_columns
from vehicle_client.recording.public import COMMA2K19_RAV4, FERRARI_250LM, IAC_AV21
from vehicle_client.recording.resampling import repeated_count
from vehicle_client.shell.sources import (
    TABLE_SUFFIXES,
    nobody_watches,
    read_columns,
    read_mapped,
    read_recording,
    read_vehicle,
)
from vehicle_client.vehicle_profile import PAPER_VEHICLE, VehicleProfile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from vehicle_client.recording.series import SeriesCount


class RecordingFormat(StrEnum):
    """Whose recording it is."""

    ROADGRIP = "roadgrip"
    """Our own columns, see `vehicle_client.recording.channels`."""
    FERRARI_250LM = "ferrari-250lm"
    """Stanford's Revs programme: a Ferrari 250 LM."""
    IAC_AV21 = "iac-av21"
    """Indy Autonomous Challenge: an AV-21."""
    COMMA2K19_RAV4 = "comma2k19-rav4"
    """comma2k19: a Toyota RAV4."""


MAPPINGS = {
    RecordingFormat.FERRARI_250LM: FERRARI_250LM,
    RecordingFormat.IAC_AV21: IAC_AV21,
    RecordingFormat.COMMA2K19_RAV4: COMMA2K19_RAV4,
}


@dataclass(frozen=True, slots=True)
class RecordedAs:
    """How a recording is to be read.

    Attributes:
        recording_format: Whose columns it has; does not matter with `signals`.
        signals: Path of a file `signals.toml`, or `example`; none if empty.
        vehicle: Path of a file that describes the car; what the other two say of it if None.
    """

    recording_format: RecordingFormat = RecordingFormat.ROADGRIP
    signals: str = ""
    vehicle: Path | None = None


@dataclass(frozen=True, slots=True)
class RecordedDrive:
    """A recording and the car that drove it.

    Attributes:
        recording: What was read.
        vehicle: The car.
        counts: What each channel is worth, where they came each with time stamps of its own.
    """

    recording: Recording
    vehicle: VehicleProfile
    counts: Mapping[str, SeriesCount] = field(default_factory=dict)

    @property
    def line(self) -> DrivenLine:
        """The line the vehicle drove, by its yaw rate and its speed.

        The speed is a reference instrument's where the recording has one, else the mean of the wheels that do not
        steer.
        """
        trace, reference = self.recording.trace, self.recording.reference
        speed_mps = reference.get("velocity_x_mps", trace.wheel_speed_mps[:, 2:].mean(axis=1))
        return driven_line(speed_mps, trace.yaw_rate_radps, reference.get("velocity_y_mps"))


def read_drive(
    path: Path, recorded: RecordedAs, *, watch: Callable[[int, float], None] = nobody_watches
) -> RecordedDrive:
    """Return the drive that a file holds.

    Args:
        path: The recording.
        recorded: How to read it.
        watch: Told now and then how many frames of a CAN log are read, and the time stamp of the last.

    Raises:
        ConfigurationError: A file cannot be read, or is not of the kind that its name says.
        TraceError: It is no such recording; the message says where.
        ModuleNotFoundError: .parquet and .mf4 need the extra `vehicle-files`.
    """
    vehicle = None if recorded.vehicle is None else read_vehicle(recorded.vehicle)
    if recorded.signals:
        mapped = read_mapped(path, recorded.signals, watch=watch)
        aligned = mapped.aligned
        recording = Recording(
            trace=aligned.trace,
            reference={},
            missing=aligned.missing,
            repeated_count=sum(count.repeated_count for count in aligned.counts.values()),
        )
        return RecordedDrive(recording, vehicle or mapped.vehicle, aligned.counts)
    if not path.name.lower().endswith(TABLE_SUFFIXES):
        raise ConfigurationError(
            f"{path} is no table ({', '.join(TABLE_SUFFIXES)}); a CAN log needs --signals signals.toml, which says "
            "what its frames mean"
        )
    try:
        return _from_table(path, recorded.recording_format, vehicle)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error


def _from_table(path: Path, recording_format: RecordingFormat, vehicle: VehicleProfile | None) -> RecordedDrive:
    mapping = MAPPINGS.get(recording_format)
    if mapping is not None:
        known = VehicleProfile(name=recording_format.value, geometry=mapping.vehicle)
        return RecordedDrive(read_recording(path, mapping), vehicle or known)
    columns = read_columns(path)
    trace = trace_of_columns(columns, place=path.name)
    recording = Recording(trace=trace, reference={}, missing=(), repeated_count=repeated_count(columns["time_s"]))
    return RecordedDrive(recording, vehicle or PAPER_VEHICLE)
