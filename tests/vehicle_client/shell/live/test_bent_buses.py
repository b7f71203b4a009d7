"""Channels of a bus that fall silent, clocks that jump: a passage is refused or flagged for a reason, never a crash."""

import asyncio
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roadgrip.records import Reason
from tests.vehicle_client.shell.live.cars import ROAD, a_drive
from vehicle_client.estimation.trace import Trace
from vehicle_client.recording.channels import FIX_CHANNELS, WHEEL_COLUMNS
from vehicle_client.recording.series import Series
from vehicle_client.shell.live.client import LiveClient
from vehicle_client.shell.live.ring import Readings
from vehicle_client.shell.live.settings import LiveSettings
from vehicle_client.shell.live.source import PlayedTrace

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

SPEEDUP = 60.0
APPROACH_M = 950.0
"""A pass that is over makes way for the next one of its section after 500 m; the pipeline takes some of them."""
FROM_S, SILENCE_S = 75.0, 3.0
"""The car is in the section from 63 s to 90 s."""
JUMP_S = 1.0
BURST_STEP_RATIO = 1e-4
Bend = Callable[[str, Series], Series]


class BentBus(PlayedTrace):
    """A recording whose readings are bent before anybody sees them."""

    def __init__(self, trace: Trace, bend: Bend) -> None:
        super().__init__(trace, speedup_ratio=SPEEDUP)
        self._bend = bend

    def take(self, *, until_s: float) -> Readings:
        bent = {name: self._bend(name, series) for name, series in super().take(until_s=until_s).items()}
        return {name: series for name, series in bent.items() if len(series.time_s)}


def silent(*channels: str) -> Bend:
    def bend(name: str, series: Series) -> Series:
        if channels and name not in channels:
            return series
        kept = (series.time_s < FROM_S) | (series.time_s >= FROM_S + SILENCE_S)
        return Series(series.time_s[kept], series.values[kept])

    return bend


def jumps(by_s: float, *channels: str, for_s: float = JUMP_S) -> Bend:
    def bend(name: str, series: Series) -> Series:
        if channels and name not in channels:
            return series
        off = (series.time_s >= FROM_S) & (series.time_s < FROM_S + for_s)
        return Series(np.where(off, series.time_s + by_s, series.time_s), series.values)

    return bend


def stalled(name: str, series: Series) -> Series:
    """Stamp what came in some seconds when they were over, as a process that was stopped finds it in its socket."""
    off = (series.time_s >= FROM_S) & (series.time_s < FROM_S + SILENCE_S)
    burst_s = FROM_S + SILENCE_S - BURST_STEP_RATIO * (FROM_S + SILENCE_S - series.time_s)
    del name
    return Series(np.where(off, burst_s, series.time_s), series.values)


def told(folder: Path, trace: Trace, bend: Bend) -> list[dict[str, Any]]:
    """Return the client's log of a drive, far from any unit."""
    lines: list[dict[str, Any]] = []

    async def story() -> None:
        settings = LiveSettings(spool_folder=folder, sections=(ROAD,), once=True)
        client = LiveClient(settings, BentBus(trace, bend), write=lambda line: lines.append(json.loads(line)))
        await asyncio.wait_for(client.run(), 90.0)

    asyncio.run(story())
    return lines


def passages_of(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what became of the passages of a client that came to its end without a failure."""
    assert "failure" not in {line["event"] for line in lines}
    assert lines[-1]["event"] == "stopped"
    assert lines[-1]["passages_open"] == 0
    return [line for line in lines if line["event"] == "passage"]


def driven_twice(trace: Trace, *, pause_s: float = 1.0) -> Trace:
    """Return a drive and the same once more."""
    assert trace.gnss is not None
    by_s = float(trace.time_s[-1]) + pause_s

    def twice(name: str, of: object, *, later_s: float = 0.0) -> Any:
        values = getattr(of, name)
        return np.concatenate([values, values + later_s if later_s else values])

    names = (
        "accel_x_mps2",
        "accel_y_mps2",
        "roll_rate_radps",
        "yaw_rate_radps",
        "steer_rad",
        "wheel_speed_mps",
        "valid",
    )
    gnss = replace(
        trace.gnss,
        time_s=twice("time_s", trace.gnss, later_s=by_s),
        **{name: twice(name, trace.gnss) for name in ("lat_deg", "lon_deg", "accuracy_m")},
    )
    again = {name: twice(name, trace) for name in names}
    return replace(trace, time_s=twice("time_s", trace, later_s=by_s), gnss=gnss, **again)


SENSORS: dict[str, Bend] = {
    "one channel silent": silent("yaw_rate_radps"),
    "all wheels silent": silent(*WHEEL_COLUMNS),
    "everything silent": silent(),
    "everything in a burst": stalled,
    "one stamp ahead": jumps(5.0, "yaw_rate_radps"),
    "one stamp back": jumps(-5.0, "yaw_rate_radps"),
    "one stamp a little back": jumps(-0.5, "yaw_rate_radps"),
    "all stamps ahead": jumps(5.0),
    "all stamps back": jumps(-5.0),
    "all stamps an hour ahead": jumps(3_600.0),
    "one stamp endless": jumps(np.inf, "yaw_rate_radps"),
    "one stamp nothing": jumps(np.nan, "yaw_rate_radps"),
}
FOR_GOOD: dict[str, Bend] = {"all stamps years ahead for good": jumps(1.7e9, for_s=1e9)}
FIXES: dict[str, Bend] = {
    "latitudes years ahead": jumps(1.7e9, "lat_deg"),
    "fixes ahead": jumps(5.0, *FIX_CHANNELS),
    "fixes back": jumps(-5.0, *FIX_CHANNELS),
    "fixes silent": silent(*FIX_CHANNELS),
}


QUICK = {
    "one channel silent",
    "everything in a burst",
    "all stamps back",
    "all stamps years ahead for good",
    "fixes ahead",
}


def names_of(cases: dict[str, Bend]) -> list[Any]:
    """Return the names of cases; what says little more than another is for the long run."""
    return [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in cases]


@pytest.mark.parametrize("name", names_of(SENSORS))
def test_with_positions_a_passage_is_refused_for_a_reason_and_the_next_one_is_taken(tmp_path: Path, name: str):
    first, second = passages_of(told(tmp_path, driven_twice(a_drive(approach_m=APPROACH_M)), SENSORS[name]))
    assert first["ending"] == "withheld"
    assert first["withheld"] in {Reason.TOO_MANY_GAPS, Reason.PASSAGE_ABORTED, Reason.WRONG_ROAD}
    assert second["ending"] == "unanswered"
    assert second["spooled"]


@pytest.mark.parametrize("name", names_of(SENSORS | FOR_GOOD))
def test_without_positions_a_passage_is_refused_for_a_reason(tmp_path: Path, name: str):
    passages = passages_of(told(tmp_path, a_drive(satellites=False, approach_m=APPROACH_M), (SENSORS | FOR_GOOD)[name]))
    assert {passage["ending"] for passage in passages} == {"withheld"}
    assert {passage["withheld"] for passage in passages} <= {"too_many_gaps", "passage_aborted", "wrong_road"}


@pytest.mark.parametrize("name", names_of(FIXES))
def test_positions_that_cannot_be_right_are_flagged(tmp_path: Path, name: str):
    (passage,) = passages_of(told(tmp_path, a_drive(approach_m=APPROACH_M), FIXES[name]))
    assert passage["ending"] == "withheld" or passage["quality"]
