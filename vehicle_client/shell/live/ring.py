"""The last minutes of every sensor, in memory that each channel takes once, with its first value, and never grows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from roadgrip.errors import TraceError
from vehicle_client.recording.channels import CHANNELS, FIX_CHANNELS, SERIES_CHANNELS, STABILITY_CHANNELS, WHEEL_COLUMNS
from vehicle_client.recording.series import Series, trace_of_series

if TYPE_CHECKING:
    from collections.abc import Mapping

    from vehicle_client.estimation.trace import Trace

RING_S = 600.0
"""Ten minutes at 100 values a second: a section of 10 km at 60 km/h, or a short one with a queue before it."""
SENSOR_HZ = 100.0
FIX_HZ = 20.0
FLAG_HZ = 50.0
SLOWER_HZ = dict.fromkeys(FIX_CHANNELS, FIX_HZ) | dict.fromkeys(STABILITY_CHANNELS, FLAG_HZ)
"""A channel that speaks faster than this is kept for less long."""
CLOCK_RESET_S = 1.0
"""A sender whose time falls by more than this has begun anew; what it said before has no place any more."""

Readings: TypeAlias = "Mapping[str, Series]"
"""What came from the sensors in a short while, by channel (`SERIES_CHANNELS`), each in the order of time."""


@dataclass(slots=True)
class RingCounts:
    """What the ring could not keep.

    Attributes:
        late_count: Values that were not newer than the last one of their channel.
        reset_count: Times a channel's clock fell back.
        unknown_count: Values of channels that nobody asked for.
    """

    late_count: int = 0
    reset_count: int = 0
    unknown_count: int = 0


@dataclass(frozen=True, slots=True)
class Recorded:
    """A copy of what the ring holds of some time.

    Attributes:
        series: By channel.
        missing: Sensors that this car does not have.
    """

    series: Mapping[str, Series]
    missing: tuple[str, ...]


class SampleRing:
    """Every channel's last values, each with its own time, as they came."""

    def __init__(self, *, duration_s: float = RING_S) -> None:
        """Start empty.

        Args:
            duration_s: What is kept at 100 values a second; a channel that speaks faster is kept for less long.
        """
        self._duration_s = duration_s
        self._channels = {
            name: _Ring(
                round(duration_s * SLOWER_HZ.get(name, SENSOR_HZ)),
                # Seven digits hold what a sensor resolves; a position needs more, and so does time.
                values_of=np.float64 if name in FIX_CHANNELS else np.float32,
            )
            for name in SERIES_CHANNELS
        }
        self._travelled = _Ring(round(duration_s * FIX_HZ))
        self._driven_m = 0.0
        self._wheels_s = -np.inf
        self._speed_mps = 0.0
        self.counts = RingCounts()

    @property
    def size_bytes(self) -> int:
        """Memory of all arrays so far; `limit_bytes` when every channel has spoken."""
        return sum(ring.size_bytes for ring in (*self._channels.values(), self._travelled))

    @property
    def limit_bytes(self) -> int:
        """Memory of all arrays when every channel has spoken."""
        return sum(ring.limit_bytes for ring in (*self._channels.values(), self._travelled))

    @property
    def driven_m(self) -> float:
        """Distance since the start, from the mean of the wheels; never falls."""
        return self._driven_m

    @property
    def speed_mps(self) -> float:
        """Of the wheels, lately."""
        return self._speed_mps

    def last(self, name: str) -> tuple[float, float] | None:
        """Return time and value that a channel said last, if it said anything."""
        return self._channels[name].last()

    def put(self, readings: Readings) -> None:
        """Take what came."""
        for name, series in readings.items():
            ring = self._channels.get(name)
            if ring is None:
                self.counts.unknown_count += len(series.time_s)
            elif len(series.time_s):
                self._append(ring, series)
        self._drive(readings)

    def time_at(self, driven_m: float) -> float:
        """Return when the odometer showed a distance; minus infinity if that was before all that is known."""
        travelled = self._travelled.since(-np.inf)
        if len(travelled.time_s) == 0 or driven_m < travelled.values[0]:
            return -np.inf
        at = int(np.searchsorted(travelled.values, driven_m))
        return float(travelled.time_s[min(at, len(travelled.time_s) - 1)])

    def cut(self, *, since_s: float, missing: tuple[str, ...] = ()) -> Recorded:
        """Return a copy of everything from a time on, for `trace_of`, which takes longer and needs no ring.

        Args:
            since_s: Its beginning.
            missing: Sensors that this car does not have.
        """
        sensors = [self._channels[name].last_s for name in CHANNELS if name not in missing]
        end = min(sensors, default=-np.inf)
        # A clock that leapt forward must not ask for a grid over all the time it leapt.
        begin = max(since_s, end - self._duration_s)
        series = {name: ring.since(begin, until_s=end) for name, ring in self._channels.items()}
        return Recorded({name: of for name, of in series.items() if len(of.time_s)}, missing)

    def trace(self, *, since_s: float, missing: tuple[str, ...] = ()) -> Trace | None:
        """Return `trace_of` what `cut` gives."""
        return trace_of(self.cut(since_s=since_s, missing=missing))

    def _append(self, ring: _Ring, series: Series) -> None:
        newest = ring.last_s
        if series.time_s[0] < newest - CLOCK_RESET_S:
            ring.clear()
            self.counts.reset_count += 1
            newest = -np.inf
        before = np.maximum.accumulate(np.concatenate([[newest], series.time_s[:-1]]))
        newer = series.time_s > before
        self.counts.late_count += int(np.count_nonzero(~newer))
        ring.append(Series(series.time_s[newer], series.values[newer]))

    def _drive(self, readings: Readings) -> None:
        wheels = [readings[name] for name in WHEEL_COLUMNS if name in readings and len(readings[name].time_s)]
        if not wheels:
            return
        now_s = max(float(wheel.time_s[-1]) for wheel in wheels)
        # The median of four wheels: one that spins or stands does not move the car.
        means = sorted(float(wheel.values.mean()) for wheel in wheels)
        speed = (means[(len(means) - 1) // 2] + means[len(means) // 2]) / 2.0
        since_s = now_s - self._wheels_s
        if np.isfinite(speed):
            self._speed_mps = speed
            if 0.0 < since_s <= CLOCK_RESET_S:
                self._driven_m += max(0.0, speed) * since_s
        self._wheels_s = now_s
        if now_s < self._travelled.last_s - CLOCK_RESET_S:
            self._travelled.clear()
        if now_s > self._travelled.last_s:
            self._travelled.append(Series(np.array([now_s]), np.array([self._driven_m])))


def trace_of(recorded: Recorded) -> Trace | None:
    """Return a recording at 100 samples a second, or None while a sensor has said nothing."""
    try:
        return trace_of_series(recorded.series, missing=recorded.missing).trace
    except TraceError:
        return None


class _Ring:
    """Values with increasing times; the oldest make room."""

    def __init__(self, capacity_count: int, *, values_of: type[np.floating[Any]] = np.float64) -> None:
        self._capacity_count = capacity_count
        self._time_s = np.zeros(0)
        self._values = np.zeros(0, dtype=values_of)
        self._next = 0
        self._count = 0

    @property
    def size_bytes(self) -> int:
        return self._time_s.nbytes + self._values.nbytes

    @property
    def limit_bytes(self) -> int:
        return (self._time_s.itemsize + self._values.itemsize) * self._capacity_count

    @property
    def last_s(self) -> float:
        return float(self._time_s[self._next - 1]) if self._count else -np.inf

    def last(self) -> tuple[float, float] | None:
        return (self.last_s, float(self._values[self._next - 1])) if self._count else None

    def clear(self) -> None:
        self._next = self._count = 0

    def append(self, series: Series) -> None:
        capacity = self._capacity_count
        if len(self._time_s) == 0:
            # Written at once, so that the memory is really there and a long drive holds no surprise.
            self._time_s = np.full(capacity, -np.inf)
            self._values = np.full(capacity, np.nan, dtype=self._values.dtype)
        time_s, values = series.time_s[-capacity:], series.values[-capacity:]
        at = (self._next + np.arange(len(time_s))) % capacity
        self._time_s[at] = time_s
        self._values[at] = values
        self._next = (self._next + len(time_s)) % capacity
        self._count = min(capacity, self._count + len(time_s))

    def since(self, since_s: float, *, until_s: float = np.inf) -> Series:
        """Return a copy of what lies between two times, oldest first."""
        capacity = self._capacity_count
        order = (self._next - self._count + np.arange(self._count)) % capacity
        time_s = self._time_s[order]
        first, end = np.searchsorted(time_s, [since_s, until_s], side="left")
        # The value at the end itself belongs to it.
        chosen = order[first : end + 1] if end < len(order) and time_s[end] == until_s else order[first:end]
        return Series(self._time_s[chosen], self._values[chosen].astype(np.float64))
