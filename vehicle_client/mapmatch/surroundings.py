"""Everything a car knows about sections around it: which passes are open, and which may begin.

No sockets, no clock, and a bound on everything: lines and endings that are remembered, passes that are open. A pass
begins by a beacon, or by a position that nears a known section's start. At most one summary comes of each pass, and two
summaries of one section never rest on the same stretch of the recording.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, TypeAlias

from vehicle_client.mapmatch.approach import (
    AGAINST_M,
    NEAR_LINE_M,
    Moment,
    Pass,
    SummariseOrder,
    Whereabouts,
    answered,
    finished,
    heard_again,
    mapped,
    moved,
    without_map,
)

if TYPE_CHECKING:
    from roadgrip.records import Reason
    from vehicle_client.mapmatch.section_line import Place, SectionLine

LINES_LIMIT_COUNT = 32
PASSES_LIMIT_COUNT = 8
"""Sections passed at one time, overlapping ones included; one more ends the oldest."""
REACH_M = 1_000.0
"""A pass begins by position when its start is nearer than this and comes nearer."""
CLOSING_M = 50.0
ON_LINE_M = 15.0
"""So far forward on the section itself, and a pass begins in its middle (the client has just started, say)."""
SILENCE_S = 60.0
"""Beacons that were silent for so long, some of them driven, tell of another pass."""
MOVED_ON_M = 100.0
AGAIN_M = 500.0
"""Or so many metres (at least the section's length) since the last pass, though the unit was never out of reach."""
NO_MAP_PAUSE_S = 15.0
"""A unit that sent no map is asked again after this."""
FIX_AGE_LIMIT_S = 3.0
FIX_ACCURACY_LIMIT_M = 25.0


@dataclass(frozen=True, slots=True)
class Position:
    """One fix.

    Attributes:
        time_s: On the clock of the recording.
        lat_deg: WGS 84.
        lon_deg: WGS 84.
        accuracy_m: One standard deviation, as the receiver says.
    """

    time_s: float
    lat_deg: float
    lon_deg: float
    accuracy_m: float


@dataclass(frozen=True, slots=True)
class OpenOrder:
    """A pass begins: announce the arrival, get map and advice."""

    section_id: str


@dataclass(frozen=True, slots=True)
class CloseOrder:
    """A pass is over.

    Attributes:
        section_id: The section.
        why: Why nothing came of it; None after a summary, or when the map never came (`has_map` tells).
        summarised: Whether a summary was made.
        has_map: Whether the map was known.
    """

    section_id: str
    why: Reason | None
    summarised: bool
    has_map: bool


Order: TypeAlias = OpenOrder | SummariseOrder | CloseOrder


@dataclass(frozen=True, slots=True)
class _Ending:
    time_s: float
    driven_m: float
    left_at_s: float
    """End of the last summarised pass; it outlives passes that were given up."""
    no_map: bool


@dataclass(slots=True)
class _Known:
    line: SectionLine
    has_map: bool
    # How the car moves relative to it, to see that it nears.
    farthest_m: float = -inf
    first_m: float = inf
    furthest_m: float = -inf


class Surroundings:
    """The passes of one car; a state machine that is told and answers with orders."""

    def __init__(self) -> None:
        """Know nothing."""
        self._known: OrderedDict[str, _Known] = OrderedDict()
        self._passes: OrderedDict[str, Pass] = OrderedDict()
        self._endings: OrderedDict[str, _Ending] = OrderedDict()
        self._heard_s: OrderedDict[str, float] = OrderedDict()

    @property
    def passes(self) -> tuple[Pass, ...]:
        """The open passes, oldest first."""
        return tuple(self._passes.values())

    @property
    def known_count(self) -> int:
        """Sections whose line is remembered."""
        return len(self._known)

    def knows(self, section_id: str) -> bool:
        """Return whether a section's line is remembered."""
        return section_id in self._known

    def learn(self, line: SectionLine, *, has_map: bool) -> None:
        """Remember a section; a map's line replaces that of a listing, never the other way."""
        known = self._known.get(line.section_id)
        if known is None:
            self._known[line.section_id] = _Known(line, has_map)
        elif has_map or not known.has_map:
            known.line, known.has_map = line, has_map
        self._known.move_to_end(line.section_id)
        one = self._passes.get(line.section_id)
        if one is not None:
            kept = self._known[line.section_id]
            self._passes[line.section_id] = mapped(one, kept.line, has_map=kept.has_map)
        while len(self._known) > LINES_LIMIT_COUNT:
            # An open pass keeps its own line.
            self._known.popitem(last=False)

    def hear(self, section_id: str, moment: Moment, fix: Position | None = None) -> tuple[Order, ...]:
        """Take a beacon of a section; the caller has checked who sent it."""
        last_s = self._heard_s.pop(section_id, -inf)
        self._heard_s[section_id] = moment.time_s
        while len(self._heard_s) > LINES_LIMIT_COUNT:
            self._heard_s.popitem(last=False)
        one = self._passes.get(section_id)
        if one is not None:
            self._passes[section_id] = heard_again(one, moment)
            return ()
        known = self._known.get(section_id)
        if known is not None and fix is not None and _is_fresh(fix, moment) and known.line.plane is not None:
            return ()  # the car sees for itself whether it nears the section
        if not self._may_begin(section_id, moment, silent_s=moment.time_s - last_s):
            return ()
        return tuple(self._open(section_id, moment))

    def move(self, moment: Moment, fix: Position | None = None) -> tuple[Order, ...]:
        """Take where the car is now, some ten times a second."""
        fresh = fix if fix is not None and _is_fresh(fix, moment) else None
        orders: list[Order] = []
        if fresh is not None:
            for section_id, known in list(self._known.items()):
                if section_id not in self._passes and self._nears(known, fresh, moment):
                    orders += self._open(section_id, moment)
        for section_id, one in list(self._passes.items()):
            place = None if fresh is None or one.line is None else _place(one.line, fresh)
            after, order = moved(one, moment, place)
            orders += self._keep(section_id, after, moment)
            if order is not None:
                orders.append(order)
        return tuple(orders)

    def answer(
        self, section_id: str, reason: Reason | None, moment: Moment, *, left_at_s: float = -inf
    ) -> tuple[Order, ...]:
        """Take what the pipeline said to a `SummariseOrder`.

        Args:
            section_id: The section of the order.
            reason: Why there is no summary, or None if there is one.
            moment: Now.
            left_at_s: When the car left the section, if there is a summary.
        """
        one = self._passes.get(section_id)
        if one is None:
            return ()
        after = answered(one, reason, moment)
        if after.whereabouts is Whereabouts.DONE:
            after = replace(after, since_s=max(after.since_s, left_at_s))
        return tuple(self._keep(section_id, after, moment))

    def no_map(self, section_id: str, moment: Moment) -> tuple[Order, ...]:
        """Take that the unit sent no map."""
        one = self._passes.get(section_id)
        return () if one is None else tuple(self._keep(section_id, without_map(one), moment))

    def finish(self, moment: Moment) -> tuple[Order, ...]:
        """Take that nothing more will be recorded."""
        orders: list[Order] = []
        for section_id, one in list(self._passes.items()):
            after, order = finished(one)
            orders += self._keep(section_id, after, moment)
            if order is not None:
                orders.append(order)
        return tuple(orders)

    # ------------------------------------------------------------------------------------------------------- begin, end

    def _open(self, section_id: str, moment: Moment) -> list[Order]:
        orders: list[Order] = []
        if len(self._passes) >= PASSES_LIMIT_COUNT:
            oldest_id, oldest = next(iter(self._passes.items()))
            orders += self._keep(oldest_id, replace(oldest, whereabouts=Whereabouts.GIVEN_UP), moment)
        ending = self._endings.get(section_id)
        one = Pass(
            section_id,
            Whereabouts.NEAR,
            opened=moment,
            heard_m=moment.driven_m,
            since_s=-inf if ending is None else ending.left_at_s,
        )
        known = self._known.get(section_id)
        if known is not None:
            one = mapped(one, known.line, has_map=known.has_map)
        self._passes[section_id] = one
        orders.append(OpenOrder(section_id))
        return orders

    def _keep(self, section_id: str, one: Pass, moment: Moment) -> list[Order]:
        if not one.whereabouts.over:
            self._passes[section_id] = one
            return []
        del self._passes[section_id]
        summarised = one.whereabouts is Whereabouts.DONE
        self._endings.pop(section_id, None)
        self._endings[section_id] = _Ending(
            moment.time_s, moment.driven_m, left_at_s=one.since_s, no_map=not one.has_map and not summarised
        )
        while len(self._endings) > LINES_LIMIT_COUNT:
            self._endings.popitem(last=False)
        known = self._known.get(section_id)
        if known is not None:
            known.farthest_m, known.first_m, known.furthest_m = -inf, inf, -inf
        return [CloseOrder(section_id, one.why, summarised=summarised, has_map=one.has_map)]

    def _may_begin(self, section_id: str, moment: Moment, *, silent_s: float) -> bool:
        """Return whether a beacon may begin a pass: not while the last one's unit is merely still in reach."""
        ending = self._endings.get(section_id)
        if ending is None:
            return True
        if ending.no_map:
            return moment.time_s - ending.time_s >= NO_MAP_PAUSE_S
        since_m = moment.driven_m - ending.driven_m
        known = self._known.get(section_id)
        length_m = 0.0 if known is None else known.line.length_m
        return since_m >= max(AGAIN_M, length_m) or (silent_s >= SILENCE_S and since_m >= MOVED_ON_M)

    def _nears(self, known: _Known, fix: Position, moment: Moment) -> bool:
        """Return whether a position begins a pass: towards the start, or forward on the section itself."""
        place = _place(known.line, fix)
        if place is None:
            return False
        length_m = known.line.length_m
        ending = self._endings.get(known.line.section_id)
        if ending is not None and ending.no_map and moment.time_s - ending.time_s < NO_MAP_PAUSE_S:
            return False
        if place.apart_m <= NEAR_LINE_M and 0.0 < place.station_m < length_m:
            known.farthest_m = place.to_start_m
            known.first_m = min(known.first_m, place.station_m)
            known.furthest_m = max(known.furthest_m, place.station_m)
            if place.station_m < known.furthest_m - AGAINST_M:
                known.first_m = known.furthest_m = place.station_m  # against the direction; it may still turn round
            return place.station_m - known.first_m >= ON_LINE_M and place.station_m <= length_m / 2.0
        known.first_m, known.furthest_m = inf, -inf
        if place.to_start_m > REACH_M:
            known.farthest_m = place.to_start_m
            return False
        known.farthest_m = max(known.farthest_m, place.to_start_m)
        return known.farthest_m - place.to_start_m >= CLOSING_M and place.to_start_m < place.to_end_m


def _is_fresh(fix: Position, moment: Moment) -> bool:
    return -1.0 <= moment.time_s - fix.time_s <= FIX_AGE_LIMIT_S and fix.accuracy_m <= FIX_ACCURACY_LIMIT_M


def _place(line: SectionLine, fix: Position) -> Place | None:
    return line.place_of(lat_deg=fix.lat_deg, lon_deg=fix.lon_deg)
