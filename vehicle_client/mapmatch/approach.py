r"""One pass over one section while it happens: where the car is, and when there is something to summarise.

No sockets, no clock: what the car knows at a moment comes in, a pass that has moved on and an order come out::

    heard a beacon, no position     NEAR ---------tries by the odometer--------> DONE or GIVEN_UP
    positions                       APPROACHING -> INSIDE -> LEAVING -> LEFT --> DONE or GIVEN_UP

With positions the section's line tells where the car is. Without them the beacon says only that the section is in
reach: recording goes on, and the pipeline is asked a few times whether the section is in the recording, until the
distance driven since the beacon rules it out. Positions that stop (a tunnel) leave the pass to the odometer, positions
that come take it over.

The pipeline has the last word: what is decided here is when it is asked, and when asking is pointless.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf
from typing import TYPE_CHECKING

from roadgrip.records import Reason

if TYPE_CHECKING:
    from vehicle_client.mapmatch.section_line import Place, SectionLine

NEAR_LINE_M = 40.0
"""Farther beside the line is another road; two lanes, and a receiver in a forest, lie within."""
EXIT_M = 30.0
"""Recorded beyond the end before the pipeline is asked: its filters lean on what comes after."""
EXIT_LIMIT_S = 3.0
"""A car that stops right behind the end need not drive those metres."""
ASTRAY_S = 2.0
"""So long beside the line, and the car has left the road."""
TURNED_M = 50.0
"""So far back along the section, and the car has turned round; a standing receiver wanders less."""
AGAINST_M = 30.0
"""So far back along the line before it was ever driven forward: the other direction."""
FORWARD_M = 10.0
"""So far forward along the line, and the car drives in the section's direction."""
APPROACH_LIMIT_M = 5_000.0
"""An approach longer than this is no approach."""
AWAY_M = 300.0
"""Farther from the section than the nearest it ever was, by this: the car took another road."""
STANDING_MPS = 0.5
STANDING_S = 3.0
"""So long at rest inside the section, and the pipeline would refuse: below 2 m/s a car says nothing about the road."""
BEYOND_RATIO = 1.3
BEYOND_M = 500.0
"""A section is ruled out after 1.3 times its length and 500 m since the beacon (or since its start, once placed)."""
HEARD_AHEAD_LIMIT_M = 2_000.0
"""Later beacons push that on, but never farther than this from the first."""
LATE_BEACON_M = 250.0
"""A beacon every 10 s may be heard so late, at 25 m/s; the section may already lie that far behind."""
TRY_STEP_M = 150.0
TRIES_LIMIT_COUNT = 12
"""The pipeline is asked at most so often in one pass, whatever happens; each costs some 10 ms."""
PLACED_TRIES_COUNT = 3
"""So often when positions say that the section was driven: its end may lie some metres off."""
NO_MAP_LIMIT_M = 3_000.0
"""A pass whose map has not come by then is given up."""
BACK_M = 600.0
"""How far before the section a recording is cut: straight road to estimate offsets on, and a beacon heard late."""

RETRYING = frozenset({Reason.WRONG_ROAD, Reason.PASSAGE_ABORTED, Reason.TOO_SHORT, Reason.TOO_MANY_GAPS})
"""Refusals that may mean "not yet", or "not in what you showed me"."""


class Whereabouts(StrEnum):
    """Where the car is relative to a section that it knows of."""

    AWAY = "away"
    """Nothing speaks for a pass."""
    NEAR = "near"
    """The unit was heard; no position says where the section is."""
    APPROACHING = "approaching"
    INSIDE = "inside"
    LEAVING = "leaving"
    """Beyond the end; a little more is recorded."""
    LEFT = "left"
    """The pipeline is asked."""
    DONE = "done"
    """Summarised."""
    GIVEN_UP = "given_up"
    """There will be no summary, for the reason in `Pass.why`."""

    @property
    def over(self) -> bool:
        """Whether nothing more can come of the pass."""
        return self in {Whereabouts.DONE, Whereabouts.GIVEN_UP}


@dataclass(frozen=True, slots=True)
class Moment:
    """What the car knows about itself now.

    Attributes:
        time_s: On the clock of the recording.
        driven_m: By the odometer, since the client started; never falls.
        speed_mps: Of the wheels.
    """

    time_s: float
    driven_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class SummariseOrder:
    """Ask the pipeline whether the section is in the recording.

    Attributes:
        section_id: The section.
        since_m: The recording goes back to this reading of the odometer...
        since_s: ...but not before this time, the end of an earlier pass.
    """

    section_id: str
    since_m: float
    since_s: float


@dataclass(frozen=True, eq=False, slots=True)
class Pass:
    """One pass over a section, from the first hint of it to its end.

    Attributes:
        section_id: The section.
        whereabouts: Where the car is.
        opened: When the pass began.
        heard_m: Odometer at the beacon that counts.
        since_s: End of the last summarised pass of this section; nothing before it is shown to the pipeline again.
        line: The section, once its map or its anchors are known.
        has_map: Whether the map is known: without it nothing can be cut.
        zero_m: Odometer at the section's start, once a position told.
        first_m: Least station since the car is on the line.
        furthest_m: Greatest station since then.
        nearest_m: Least distance to the section so far.
        astray_since_s: Since when the car is beside the line.
        standing_since_s: Since when it stands.
        leaving_since_s: Since when it is beyond the end.
        tries_count: How often the pipeline was asked.
        next_try_m: Odometer at which it is asked again.
        asked: Whether its answer is awaited.
        why: Why the pass was given up.
    """

    section_id: str
    whereabouts: Whereabouts
    opened: Moment
    heard_m: float
    since_s: float = -inf
    line: SectionLine | None = None
    has_map: bool = False
    zero_m: float | None = None
    first_m: float = inf
    furthest_m: float = -inf
    nearest_m: float = inf
    astray_since_s: float = inf
    standing_since_s: float = inf
    leaving_since_s: float = inf
    tries_count: int = 0
    next_try_m: float = -inf
    asked: bool = False
    why: Reason | None = None


def heard_again(one: Pass, moment: Moment) -> Pass:
    """Return the pass after one more beacon of its section."""
    limit = one.opened.driven_m + HEARD_AHEAD_LIMIT_M
    return replace(one, heard_m=max(one.heard_m, min(moment.driven_m, limit)))


def mapped(one: Pass, line: SectionLine, *, has_map: bool) -> Pass:
    """Return the pass after its section's line became known, or known better."""
    return replace(one, line=line, has_map=has_map or one.has_map)


def moved(one: Pass, moment: Moment, place: Place | None) -> tuple[Pass, SummariseOrder | None]:
    """Return the pass after the car drove on, and whether the pipeline is to be asked now.

    Args:
        one: A pass that is not over.
        moment: Now.
        place: Where the car is beside the section's line; None without a fresh position.
    """
    if one.asked or one.whereabouts.over:
        return one, None
    if place is not None and one.line is not None:
        one = _placed(one, moment, place, length_m=one.line.length_m)
    elif one.whereabouts is not Whereabouts.LEFT:
        one = replace(one, astray_since_s=inf, standing_since_s=inf)
    if one.whereabouts.over:
        return one, None
    return _tried(one, moment, placed=place is not None)


def answered(one: Pass, reason: Reason | None, moment: Moment) -> Pass:
    """Return the pass after the pipeline answered: None for a summary, else why there is none (yet)."""
    one = replace(one, asked=False)
    if one.whereabouts.over:
        return one
    if reason is None:
        return replace(one, whereabouts=Whereabouts.DONE)
    placed = one.whereabouts is Whereabouts.LEFT
    tries_limit = PLACED_TRIES_COUNT if placed else TRIES_LIMIT_COUNT
    if reason not in RETRYING or one.tries_count >= tries_limit or _ruled_out(one, moment):
        return _given_up(one, reason)
    return one


def finished(one: Pass) -> tuple[Pass, SummariseOrder | None]:
    """Return the pass when nothing more will be recorded: the pipeline is asked once more, if it can answer."""
    if one.asked or one.whereabouts.over:
        return one, None
    if not one.has_map:
        return _given_up(one, None), None
    if one.tries_count >= TRIES_LIMIT_COUNT:
        return _given_up(one, Reason.PASSAGE_ABORTED), None
    # Whatever it answers, there is no further try.
    return _ask(replace(one, tries_count=TRIES_LIMIT_COUNT - 1), inf)


def without_map(one: Pass) -> Pass:
    """Return the pass after the unit sent no map, given up unless the car had one."""
    return one if one.has_map or one.whereabouts.over else _given_up(one, None)


# ------------------------------------------------------------------------------------------------------ with positions


def _placed(one: Pass, moment: Moment, place: Place, *, length_m: float) -> Pass:
    one = replace(one, nearest_m=min(one.nearest_m, place.apart_m))
    # Beyond its ends the line goes on straight, which the road soon does not.
    on_line = abs(place.lateral_m) <= NEAR_LINE_M and place.apart_m <= 2.0 * NEAR_LINE_M
    if on_line:
        one = replace(one, zero_m=moment.driven_m - place.station_m)
    match one.whereabouts:
        case Whereabouts.NEAR | Whereabouts.APPROACHING:
            return _before(one, moment, place, on_line=on_line, length_m=length_m)
        case Whereabouts.INSIDE:
            return _inside(one, moment, place, length_m=length_m)
        case Whereabouts.LEAVING if place.station_m < length_m - TURNED_M:
            return _given_up(one, Reason.PASSAGE_ABORTED)
        case Whereabouts.LEAVING:
            gone = place.station_m >= length_m + EXIT_M or place.apart_m >= EXIT_M
            if gone or moment.time_s - one.leaving_since_s >= EXIT_LIMIT_S:
                return replace(one, whereabouts=Whereabouts.LEFT, next_try_m=moment.driven_m)
        case _:
            pass
    return one


def _before(one: Pass, moment: Moment, place: Place, *, on_line: bool, length_m: float) -> Pass:
    station = place.station_m
    if not on_line:
        if place.apart_m <= one.nearest_m + AWAY_M and moment.driven_m - one.opened.driven_m <= APPROACH_LIMIT_M:
            return replace(one, whereabouts=Whereabouts.APPROACHING, first_m=inf, furthest_m=-inf)
        if one.has_map and one.furthest_m == -inf and one.tries_count == 0:
            # Never seen on the section, but perhaps nobody could look: the map, or the first position, came late.
            last_try = replace(one, whereabouts=Whereabouts.LEFT, tries_count=PLACED_TRIES_COUNT - 1)
            return replace(last_try, next_try_m=moment.driven_m)
        return _given_up(one, Reason.WRONG_ROAD)
    first, furthest = min(one.first_m, station), max(one.furthest_m, station)
    if station < furthest - AGAINST_M:
        return _given_up(one, Reason.WRONG_ROAD)
    one = replace(one, whereabouts=Whereabouts.APPROACHING, first_m=first, furthest_m=furthest)
    if station < max(0.0, first + FORWARD_M):
        return one
    if station <= length_m:
        return replace(one, whereabouts=Whereabouts.INSIDE)
    # First seen behind the section: the map or the beacon came late, and the recording may hold the whole pass.
    return replace(one, whereabouts=Whereabouts.LEAVING, leaving_since_s=moment.time_s)


def _inside(one: Pass, moment: Moment, place: Place, *, length_m: float) -> Pass:
    if place.station_m > length_m:
        return replace(one, whereabouts=Whereabouts.LEAVING, leaving_since_s=moment.time_s)
    if place.station_m < one.furthest_m - TURNED_M:
        return _given_up(one, Reason.PASSAGE_ABORTED)
    astray_since = min(one.astray_since_s, moment.time_s) if place.apart_m > NEAR_LINE_M else inf
    if moment.time_s - astray_since >= ASTRAY_S:
        return _given_up(one, Reason.PASSAGE_ABORTED)
    standing_since = min(one.standing_since_s, moment.time_s) if moment.speed_mps < STANDING_MPS else inf
    if moment.time_s - standing_since >= STANDING_S:
        return _given_up(one, Reason.TOO_SLOW)
    return replace(
        one,
        furthest_m=max(one.furthest_m, place.station_m),
        astray_since_s=astray_since,
        standing_since_s=standing_since,
    )


# ------------------------------------------------------------------------------------------------- when to ask, or stop


def _tried(one: Pass, moment: Moment, *, placed: bool) -> tuple[Pass, SummariseOrder | None]:
    if one.line is None or not one.has_map:
        if moment.driven_m - one.opened.driven_m > NO_MAP_LIMIT_M:
            return _given_up(one, None), None
        return one, None
    if one.whereabouts is Whereabouts.LEFT:
        return _ask(one, moment.driven_m) if moment.driven_m >= one.next_try_m else (one, None)
    if placed:
        return one, None
    if one.tries_count >= TRIES_LIMIT_COUNT:
        return _given_up(one, Reason.WRONG_ROAD), None
    # Where nobody saw the car elsewhere, the last word is the pipeline's: once ruled out it is asked a last time.
    if _ruled_out(one, moment) or moment.driven_m >= max(one.next_try_m, _first_try_m(one)):
        return _ask(one, moment.driven_m)
    return one, None


def _length_m(one: Pass) -> float:
    return 0.0 if one.line is None else one.line.length_m


def _first_try_m(one: Pass) -> float:
    length = _length_m(one)
    if one.zero_m is not None:
        return one.zero_m + length * 1.03 + EXIT_M
    return one.opened.driven_m + max(60.0, length - LATE_BEACON_M)


def _ruled_out(one: Pass, moment: Moment) -> bool:
    start_m = one.zero_m if one.zero_m is not None else one.heard_m
    return moment.driven_m - start_m > BEYOND_RATIO * _length_m(one) + BEYOND_M


def _ask(one: Pass, driven_m: float) -> tuple[Pass, SummariseOrder]:
    back_m = BACK_M if one.zero_m is not None else BACK_M + _length_m(one)
    start_m = one.zero_m if one.zero_m is not None else one.opened.driven_m
    step_m = EXIT_M if one.whereabouts is Whereabouts.LEFT else max(TRY_STEP_M, _length_m(one) / 3.0)
    asked = replace(one, asked=True, tries_count=one.tries_count + 1, next_try_m=driven_m + step_m)
    return asked, SummariseOrder(one.section_id, since_m=start_m - back_m, since_s=one.since_s)


def _given_up(one: Pass, why: Reason | None) -> Pass:
    return replace(one, whereabouts=Whereabouts.GIVEN_UP, why=why)
