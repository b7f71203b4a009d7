"""Hours behind the wheel as a source of sensor values: simulated drives one after another, plain road in between."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.estimation.trace import GnssTrack, Trace
from vehicle_client.shell.live.source import PLAYED_STEP_S, PlayedTrace, SourceState
from vehicle_client.shell.recorded import RecordedAs, read_drive

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.shell.live.ring import Readings

SAMPLES_HZ = 100.0
FIXES_KEPT_S = 20.0
"""Beside a drive with fixes the car still knows for so long where it is; then come tunnels and forests."""


@dataclass(frozen=True, slots=True)
class Leg:
    """One drive over a section, and when it happens.

    Attributes:
        file: Its recording, beside the journey's own file.
        section_id: What it drives over.
        begins_s: On the journey's clock.
        ends_s: On the journey's clock.
        with_fixes: Whether the car has positions meanwhile.
    """

    file: str
    section_id: str
    begins_s: float
    ends_s: float
    with_fixes: bool


@dataclass(frozen=True, slots=True)
class Journey:
    """All that a car drives, in the order of time."""

    legs: tuple[Leg, ...]
    duration_s: float


def write_journey(path: Path, journey: Journey) -> None:
    """Write a journey's timetable."""
    path.write_text(json.dumps(asdict(journey)), encoding="utf-8")


def read_journey(path: Path) -> Journey:
    """Return a journey's timetable."""
    raw = json.loads(path.read_text(encoding="utf-8"))
    return Journey(tuple(Leg(**leg) for leg in raw["legs"]), float(raw["duration_s"]))


class JourneySource:
    """Plays a journey; only the piece that is driven now is in memory."""

    def __init__(self, journey: Journey, folder: Path, *, speedup_ratio: float) -> None:
        """Prepare.

        Args:
            journey: The timetable.
            folder: Holds the recordings.
            speedup_ratio: How fast it is played.
        """
        self._journey = journey
        self._folder = folder
        self._speedup_ratio = speedup_ratio
        self._start_s = time.monotonic()
        self._taken_s = 0.0
        self._pieces = self._each_piece()
        self._piece: PlayedTrace | None = None

    @property
    def state(self) -> SourceState:
        """Whether everything was driven."""
        return SourceState.ENDED if self._taken_s >= self._journey.duration_s else SourceState.RUNNING

    def start(self) -> float:
        """Set off."""
        self._start_s = time.monotonic()
        return 0.0

    def now_s(self) -> float:
        """Return the time on the journey's clock."""
        return (time.monotonic() - self._start_s) * self._speedup_ratio

    @property
    def step_s(self) -> float:
        """As for any recording that is played."""
        return PLAYED_STEP_S

    def wall_s(self, duration_s: float) -> float:
        """Return how long a duration takes on the wall."""
        return duration_s / self._speedup_ratio

    def take(self, *, until_s: float) -> Readings:
        """Return what lies between the last call and a time; at the border of two pieces, what the earlier one has."""
        self._taken_s = max(self._taken_s, until_s)
        if self._piece is None or self._piece.state is SourceState.ENDED:
            self._piece = next(self._pieces, None)
        return {} if self._piece is None else self._piece.take(until_s=until_s)

    def counts(self) -> dict[str, int]:
        """Return nothing: a recording loses nothing."""
        return {}

    def close(self) -> None:
        """Do nothing."""

    def _each_piece(self) -> Iterator[PlayedTrace]:
        rng = np.random.default_rng(0)
        before: Trace | None = None
        for leg in self._journey.legs:
            recorded = read_drive(self._folder / leg.file, RecordedAs()).recording.trace
            drive = _moved(recorded, leg.begins_s - float(recorded.time_s[0]))
            yield PlayedTrace(road_between(before, drive, rng=rng))
            yield PlayedTrace(drive)
            before = drive
        if before is not None:
            yield PlayedTrace(road_after(before, self._journey.duration_s, rng=rng))


def road_between(before: Trace | None, after: Trace, *, rng: np.random.Generator) -> Trace:
    """Return a straight road from one drive (or from the journey's start) to the next, with its sensors' noise.

    Args:
        before: The drive that is over.
        after: The drive that comes.
        rng: Chance.
    """
    begin_s = 0.0 if before is None else float(before.time_s[-1]) + 1.0 / SAMPLES_HZ
    speeds = (_end_mps(after, 0) if before is None else _end_mps(before, -1), _end_mps(after, 0))
    fixes = [_onward(after.gnss, back=True, begin_s=begin_s, end_s=float(after.time_s[0]))]
    if before is not None:
        fixes.insert(0, _onward(before.gnss, back=False, begin_s=begin_s, end_s=float(after.time_s[0])))
    return _straight(begin_s, float(after.time_s[0]) - 0.5 / SAMPLES_HZ, speeds, fixes, rng)


def road_after(before: Trace, end_s: float, *, rng: np.random.Generator) -> Trace:
    """Return a straight road from the last drive to the end of the journey."""
    begin_s = float(before.time_s[-1]) + 1.0 / SAMPLES_HZ
    fixes = [_onward(before.gnss, back=False, begin_s=begin_s, end_s=end_s)]
    return _straight(begin_s, end_s, (_end_mps(before, -1), _end_mps(before, -1)), fixes, rng)


def _straight(
    begin_s: float,
    end_s: float,
    speeds_mps: tuple[float, float],
    fixes: list[GnssTrack | None],
    rng: np.random.Generator,
) -> Trace:
    time_s = np.arange(begin_s, end_s, 1.0 / SAMPLES_HZ)
    count = len(time_s)
    speed = np.interp(time_s, [begin_s, end_s], speeds_mps)
    known = [track for track in fixes if track is not None]
    return Trace(
        time_s=time_s,
        accel_x_mps2=rng.normal(0.0, 0.03, count),
        accel_y_mps2=rng.normal(0.0, 0.03, count),
        roll_rate_radps=rng.normal(0.0, 0.002, count),
        yaw_rate_radps=rng.normal(0.0, 0.002, count),
        steer_rad=rng.normal(0.0, 0.0005, count),
        wheel_speed_mps=speed[:, None] * (1.0 + rng.normal(0.0, 0.003, (count, 4))),
        valid=np.ones(count, dtype=np.bool_),
        stability_active=np.zeros(count, dtype=np.bool_),
        gnss=_joined(known) if known else None,
    )


def _end_mps(trace: Trace, at: int) -> float:
    return float(trace.wheel_speed_mps[at].mean())


def _moved(trace: Trace, by_s: float) -> Trace:
    gnss = None if trace.gnss is None else replace(trace.gnss, time_s=trace.gnss.time_s + by_s)
    return replace(trace, time_s=trace.time_s + by_s, gnss=gnss)


def _onward(gnss: GnssTrack | None, *, back: bool, begin_s: float, end_s: float) -> GnssTrack | None:
    """Return fixes straight on behind a drive's last one, or straight towards its first."""
    if gnss is None or len(gnss.time_s) < 8:
        return None
    first, second = (0, 7) if back else (-8, -1)
    step_s = float(gnss.time_s[1] - gnss.time_s[0])
    edge_s = float(gnss.time_s[first if back else second])
    if back:
        time_s = edge_s - step_s * np.arange(int(FIXES_KEPT_S / step_s), 0, -1)
    else:
        time_s = edge_s + step_s * np.arange(1, int(FIXES_KEPT_S / step_s) + 1)
    time_s = time_s[(time_s >= begin_s) & (time_s < end_s)]

    def along(values: FloatArray) -> FloatArray:
        rate = (values[second] - values[first]) / (gnss.time_s[second] - gnss.time_s[first])
        return np.asarray(values[first if back else second] + rate * (time_s - edge_s), dtype=np.float64)

    def held(values: FloatArray) -> FloatArray:
        return np.full(len(time_s), values[first if back else second])

    return GnssTrack(
        time_s.astype(np.float64),
        along(gnss.lat_deg),
        along(gnss.lon_deg),
        held(gnss.accuracy_m),
        speed_mps=None if gnss.speed_mps is None else held(gnss.speed_mps),
    )


def _joined(tracks: list[GnssTrack]) -> GnssTrack:
    """Return tracks one after the other; where they overlap, the earlier one's fixes."""
    kept = [tracks[0]]
    for track in tracks[1:]:
        later = track.time_s > (kept[-1].time_s[-1] if len(kept[-1].time_s) else -np.inf)
        kept.append(track.where(later))
    speeds = [track.speed_mps for track in kept if track.speed_mps is not None]
    return GnssTrack(
        np.concatenate([track.time_s for track in kept]),
        np.concatenate([track.lat_deg for track in kept]),
        np.concatenate([track.lon_deg for track in kept]),
        np.concatenate([track.accuracy_m for track in kept]),
        speed_mps=np.concatenate(speeds) if len(speeds) == len(kept) else None,
    )
