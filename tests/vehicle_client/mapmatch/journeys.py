"""A car's way along a road, told in a few words, with a pipeline that knows the truth."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from roadgrip.geodesy import frame_of
from roadgrip.records import Reason
from roadgrip.section import RoadSection
from vehicle_client.mapmatch.approach import Moment, SummariseOrder, Whereabouts
from vehicle_client.mapmatch.section_line import line_of_section
from vehicle_client.mapmatch.surroundings import CloseOrder, OpenOrder, Order, Position, Surroundings

STEP_S = 0.1
BEACON_S = 10.0


@dataclass
class Journey:
    """Drives along the line of one section and its straight continuation, whatever the car itself knows of that.

    Attributes:
        section: The road.
        satellites: Whether the car has positions.
        map_known: Whether the car has the map from an earlier day.
        map_delay_s: How long after the announcement the map comes; infinite if never.
        unit_at_m: Where the unit stands, as a station.
        reach_m: How far it is heard; 0 if it is silent.
        speed_mps: Of the car, when it drives.
    """

    section: RoadSection
    satellites: bool = True
    map_known: bool = False
    map_delay_s: float = 1.0
    unit_at_m: float = 300.0
    reach_m: float = 400.0
    speed_mps: float = 20.0
    surroundings: Surroundings = field(default_factory=Surroundings)
    station_m: float = -1_500.0
    lateral_m: float = 0.0
    time_s: float = 100.0
    driven_m: float = 0.0
    log: list[Order] = field(default_factory=list)
    passed: list[tuple[float, float]] = field(default_factory=list)
    """True passages: when they began and ended."""
    summaries: list[tuple[float, float]] = field(default_factory=list)
    """What the pipeline made: the true passages again."""

    def __post_init__(self) -> None:
        self._frame = frame_of(self.section)
        self._entered_s: float | None = None
        self._beacon_s = -inf
        self._map_due: dict[str, float] = {}
        self._odometer: list[tuple[float, float]] = []
        self.line = line_of_section(self.section)
        if self.map_known:
            self.surroundings.learn(self.line, has_map=True)

    # What a car may do.

    def drive_to(self, station_m: float, *, lateral_m: float = 0.0, satellites: bool | None = None) -> Journey:
        """Drive along the line, forward or back, to a station; the lane is changed at once."""
        self.lateral_m = lateral_m
        kept, self.satellites = self.satellites, self.satellites if satellites is None else satellites
        while abs(station_m - self.station_m) > 1e-6:
            step = float(np.clip(station_m - self.station_m, -self.speed_mps * STEP_S, self.speed_mps * STEP_S))
            self._step(step, speed_mps=self.speed_mps)
        self.satellites = kept
        return self

    def drive_elsewhere(self, distance_m: float, *, lateral_m: float = 5_000.0) -> Journey:
        """Drive on another road, out of reach and far from the section."""
        self.lateral_m = lateral_m
        for _ in range(round(distance_m / self.speed_mps / STEP_S)):
            self._step(0.0, speed_mps=self.speed_mps, driven_m=self.speed_mps * STEP_S)
        return self

    def stand(self, duration_s: float) -> Journey:
        for _ in range(round(duration_s / STEP_S)):
            self._step(0.0, speed_mps=0.0)
        return self

    def hear(self, section_id: str) -> Journey:
        """Hear a beacon of another section."""
        self._take(self.surroundings.hear(section_id, self.moment))
        return self

    def finish(self) -> Journey:
        """End the recording."""
        self._take(self.surroundings.finish(self.moment))
        return self

    # What came of it.

    @property
    def moment(self) -> Moment:
        return Moment(self.time_s, self.driven_m, self.speed_mps)

    @property
    def asked_count(self) -> int:
        return sum(isinstance(order, SummariseOrder) for order in self.log)

    @property
    def opened_count(self) -> int:
        return sum(isinstance(order, OpenOrder) for order in self.log)

    @property
    def closings(self) -> list[CloseOrder]:
        return [order for order in self.log if isinstance(order, CloseOrder)]

    @property
    def whereabouts(self) -> Whereabouts:
        found = [p.whereabouts for p in self.surroundings.passes if p.section_id == self.section.section_id]
        return found[0] if found else Whereabouts.AWAY

    # How it works.

    def _step(self, station_step_m: float, *, speed_mps: float, driven_m: float | None = None) -> None:
        before_m = self.station_m
        self.time_s += STEP_S
        self.station_m += station_step_m
        self.driven_m += abs(station_step_m) if driven_m is None else driven_m
        self._odometer.append((self.time_s, self.driven_m))
        self._note_truth(before_m)
        moment = Moment(self.time_s, self.driven_m, speed_mps)
        fix = self._fix() if self.satellites else None
        distance_m = float(np.hypot(self.station_m - self.unit_at_m, self.lateral_m))
        if distance_m <= self.reach_m and self.time_s - self._beacon_s >= BEACON_S:
            self._beacon_s = self.time_s
            self._take(self.surroundings.hear(self.section.section_id, moment, fix))
        for section_id, due_s in list(self._map_due.items()):
            if self.time_s >= due_s:
                del self._map_due[section_id]
                self.surroundings.learn(replace(self.line, section_id=section_id), has_map=True)
        self._take(self.surroundings.move(moment, fix))

    def _note_truth(self, before_m: float) -> None:
        length_m = self.section.length_m
        if self.lateral_m != 0.0 or self.station_m < before_m:
            self._entered_s = None
        elif before_m < 0.0 <= self.station_m:
            self._entered_s = self.time_s
        elif before_m < length_m <= self.station_m and self._entered_s is not None:
            self.passed.append((self._entered_s, self.time_s))
            self._entered_s = None

    def _fix(self) -> Position:
        profile = self.section.profile
        at = float(np.clip(self.station_m, 0.0, self.section.length_m))
        heading = float(np.interp(at, profile.station_m, profile.heading_rad))
        beyond = self.station_m - at
        x = float(np.interp(at, profile.station_m, profile.x_m)) + beyond * np.cos(heading)
        y = float(np.interp(at, profile.station_m, profile.y_m)) + beyond * np.sin(heading)
        lat, lon = self._frame.to_lat_lon(x - self.lateral_m * np.sin(heading), y + self.lateral_m * np.cos(heading))
        return Position(self.time_s, float(lat), float(lon), accuracy_m=2.0)

    def _take(self, orders: tuple[Order, ...]) -> None:
        self.log += orders
        for order in orders:
            if isinstance(order, OpenOrder):
                self._map_due[order.section_id] = self.time_s + self.map_delay_s
            elif isinstance(order, SummariseOrder):
                self._answer(order)

    def _answer(self, order: SummariseOrder) -> None:
        """Be the pipeline: find the last whole passage in what it is shown."""
        shown_s = max(order.since_s, min((t for t, d in self._odometer if d >= order.since_m), default=self.time_s))
        found = [p for p in self.passed if p[0] >= shown_s - 1e-9]
        if found:
            self.summaries.append(found[-1])
            reason, left_at_s = None, found[-1][1]
        else:
            reason, left_at_s = Reason.WRONG_ROAD, -inf
        answer = self.surroundings.answer(order.section_id, reason, self.moment, left_at_s=left_at_s)
        self._take(answer)

    def each_passage_was_summarised_at_most_once(self) -> bool:
        return all(count == 1 for count in Counter(self.summaries).values())
