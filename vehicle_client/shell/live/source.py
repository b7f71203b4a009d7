"""Where sensor values come from: one Protocol for a bus and for a recording that is played."""

from __future__ import annotations

import time
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

import numpy as np

from roadgrip.errors import ConfigurationError
from vehicle_client.recording.channels import FIX_CHANNELS, SENSOR_COLUMNS, STABILITY_COLUMN, WHEEL_COLUMNS
from vehicle_client.recording.series import Series

if TYPE_CHECKING:
    from collections.abc import Callable

    from vehicle_client.estimation.trace import GnssTrack, Trace
    from vehicle_client.shell.can.live import CanSource
    from vehicle_client.shell.live.ring import Readings


PLAYED_STEP_S = 0.1


class SourceState(StrEnum):
    """How a source of sensor values is; part of what the dashboard is told."""

    RUNNING = "running"
    BROKEN = "broken"
    """The bus broke, and is being opened again."""
    ENDED = "ended"
    """Nothing will come any more."""


class Source(Protocol):
    """Values of sensors as they come. Nothing here waits."""

    @property
    def state(self) -> SourceState:
        """How it is."""
        ...

    def start(self) -> float:
        """Let the clock run, and return its time."""
        ...

    def now_s(self) -> float:
        """Return the time on the clock that the values' times are on."""
        ...

    @property
    def step_s(self) -> float:
        """The longest time that `take` may be asked for at once."""
        ...

    def wall_s(self, duration_s: float) -> float:
        """Return how long a duration on that clock takes on the wall."""
        ...

    def take(self, *, until_s: float) -> Readings:
        """Return what came since the last call; a recording gives what is not later than `until_s`."""
        ...

    def counts(self) -> dict[str, int]:
        """Return what it counts about itself, such as frames that could not be read."""
        ...

    def close(self) -> None:
        """Let go of the bus."""
        ...


class PlayedTrace:
    """A recording that is played as if it happened now, so many times as fast."""

    def __init__(self, trace: Trace, *, speedup_ratio: float = 1.0) -> None:
        """Prepare."""
        self._trace = trace
        self._speedup_ratio = speedup_ratio
        self._start_s = time.monotonic()
        self._taken_s = -np.inf
        columns = {name: getattr(trace, name) for name in SENSOR_COLUMNS}
        columns |= {name: trace.wheel_speed_mps[:, i] for i, name in enumerate(WHEEL_COLUMNS)}
        if trace.stability_active is not None:
            columns[STABILITY_COLUMN] = trace.stability_active.astype(np.float64)
        self._series = {name: Series(trace.time_s[trace.valid], v[trace.valid]) for name, v in columns.items()}
        self._series |= _fix_series(trace.gnss)

    @property
    def state(self) -> SourceState:
        """Whether everything was played."""
        return SourceState.ENDED if self._taken_s >= float(self._trace.time_s[-1]) else SourceState.RUNNING

    def start(self) -> float:
        """Begin to play, and return the time of the first sample."""
        self._start_s = time.monotonic()
        return float(self._trace.time_s[0])

    def now_s(self) -> float:
        """Return how far the recording is played, on its own clock."""
        return float(self._trace.time_s[0]) + (time.monotonic() - self._start_s) * self._speedup_ratio

    @property
    def step_s(self) -> float:
        """A recording played fast is still lived through step by step."""
        return PLAYED_STEP_S

    def wall_s(self, duration_s: float) -> float:
        """Return how long a duration in the recording takes on the wall."""
        return duration_s / self._speedup_ratio

    def take(self, *, until_s: float) -> Readings:
        """Return what lies between the last call and a time."""
        bounds = (self._taken_s, until_s)
        self._taken_s = max(bounds)
        came = {}
        for name, series in self._series.items():
            first, end = np.searchsorted(series.time_s, bounds, side="right")
            if end > first:
                came[name] = Series(series.time_s[first:end], series.values[first:end])
        return came

    def counts(self) -> dict[str, int]:
        """Return nothing: a recording loses nothing."""
        return {}

    def close(self) -> None:
        """Do nothing."""


class LiveBus:
    """A car's CAN bus, read by a thread of its own."""

    def __init__(self, source: CanSource, *, now_s: Callable[[], float] = time.monotonic) -> None:
        """Take a source that reads.

        Args:
            source: Reads the bus.
            now_s: The clock that its values' times are on.
        """
        self._source = source
        self._now_s = now_s

    @property
    def state(self) -> SourceState:
        """Whether the bus can be read; one that broke is opened again."""
        return SourceState.BROKEN if self._source.broken else SourceState.RUNNING

    def start(self) -> float:
        """Return the time: a bus runs anyway."""
        return self.now_s()

    def now_s(self) -> float:
        """Return the clock that values' times are on."""
        return self._now_s()

    @property
    def step_s(self) -> float:
        """Whatever came, came; a loop that was late does not live through it again."""
        return np.inf

    def wall_s(self, duration_s: float) -> float:
        """Return the duration."""
        return duration_s

    def take(self, *, until_s: float) -> Readings:  # noqa: ARG002 - a bus knows no future
        """Return what came since the last call.

        Raises:
            ConfigurationError: Nobody reads the bus any more; only a new process helps.
        """
        if not self._source.alive:
            raise ConfigurationError(f"the CAN bus is not read any more: {self._source.counts.failure}")
        times: dict[str, list[float]] = {}
        values: dict[str, list[float]] = {}
        for channel, time_s, value in self._source.poll():
            times.setdefault(channel, []).append(time_s)
            values.setdefault(channel, []).append(value)
        return {name: Series(np.array(times[name]), np.array(values[name])) for name in times}

    def counts(self) -> dict[str, int]:
        """Return what the reader saw."""
        counts = self._source.counts
        return {
            "can_frames": counts.frames_count,
            "can_values_dropped": counts.dropped_count,
            "can_errors": counts.errors_count,
            "can_reopened": counts.reopened_count,
        }

    def close(self) -> None:
        """Stop the reader."""
        self._source.close()


def _fix_series(gnss: GnssTrack | None) -> dict[str, Series]:
    if gnss is None:
        return {}
    columns = [gnss.lat_deg, gnss.lon_deg, gnss.accuracy_m, gnss.speed_mps]
    return {
        name: Series(gnss.time_s, values)
        for name, values in zip(FIX_CHANNELS, columns, strict=True)
        if values is not None
    }
