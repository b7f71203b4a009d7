"""Sections around the car as a server over cellular lists them, for units that no radio reaches yet."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, inf, radians
from typing import TYPE_CHECKING, Any

from roadgrip.section import GnssAnchor
from vehicle_client.mapmatch.section_line import SectionLine, line_of_anchors

if TYPE_CHECKING:
    import httpx

    from vehicle_client.mapmatch.surroundings import Position
    from vehicle_client.shell.uplink import UnitAddress

QUERY_S = 900.0
"""A listing older than this is asked for again..."""
WAITING_QUERY_S = 300.0
"""...this soon while summaries wait: the answer shows that a server is there, before frames are spent on it..."""
QUERY_M = 5_000.0
"""...or when the car is farther from where it asked than this."""
BOX_HALF_M = 10_000.0
RETRY_S = 60.0
"""After a query that failed."""
LISTING_LIMIT_BYTES = 1_000_000
SECTIONS_LIMIT_COUNT = 24
"""Sections taken from one listing, the nearest first; the memory for lines is bounded too."""
_DEGREE_M = 111_195.0
_LIST_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class Listing:
    """What a server answered.

    Attributes:
        lines: Sections with positions, the nearest first.
        section_ids: All sections that it serves here.
    """

    lines: tuple[SectionLine, ...]
    section_ids: frozenset[str]


class QueryClock:
    """When to ask a server again; no sockets, no clock."""

    def __init__(self) -> None:
        """Never asked."""
        self._asked_s = -inf
        self._answered = False
        self._at: tuple[float, float] | None = None

    def due(self, position: Position | None, *, now_s: float, waiting: bool = False) -> bool:
        """Return whether the last answer is too old or too far away.

        Args:
            position: Where the car is, if it knows.
            now_s: Now.
            waiting: Whether summaries wait for a server that can be reached.
        """
        since_s = now_s - self._asked_s
        if not self._answered:
            return since_s >= RETRY_S
        if since_s >= (WAITING_QUERY_S if waiting else QUERY_S):
            return True
        if position is None or since_s < RETRY_S:
            return False
        if self._at is None:
            return True
        lat, lon = self._at
        north_m = (position.lat_deg - lat) * _DEGREE_M
        east_m = (position.lon_deg - lon) * _DEGREE_M * cos(radians(lat))
        return hypot(north_m, east_m) >= QUERY_M

    def asked(self, position: Position | None, *, now_s: float, answered: bool) -> None:
        """Take that a query was made."""
        self._asked_s = now_s
        self._answered = answered
        self._at = None if position is None else (position.lat_deg, position.lon_deg)


def bbox_around(position: Position) -> str:
    """Return the box to ask for: some 10 km in every direction, within what degrees can be."""
    north = BOX_HALF_M / _DEGREE_M
    east = BOX_HALF_M / (_DEGREE_M * max(0.01, cos(radians(position.lat_deg))))
    west_deg, east_deg = max(-180.0, position.lon_deg - east), min(180.0, position.lon_deg + east)
    south_deg, north_deg = max(-90.0, position.lat_deg - north), min(90.0, position.lat_deg + north)
    return f"{west_deg:.5f},{south_deg:.5f},{east_deg:.5f},{north_deg:.5f}"


def listing_of(answer: Any, position: Position | None) -> Listing:
    """Return what the JSON of `GET /v1/sections` says; what is not understood is left out."""
    found: list[tuple[float, SectionLine]] = []
    names: set[str] = set()
    sections = answer.get("sections") if isinstance(answer, dict) else None
    for entry in sections if isinstance(sections, list) else ():
        try:
            section_id, length_m = str(entry["section_id"]), float(entry["length_m"])
            anchors = tuple(
                GnssAnchor(float(a["station_m"]), float(a["lat_deg"]), float(a["lon_deg"])) for a in entry["anchors"]
            )
        except (KeyError, TypeError, ValueError):
            continue
        names.add(section_id)
        line = line_of_anchors(section_id, length_m=length_m, anchors=anchors)
        place = None if position is None else line.place_of(lat_deg=position.lat_deg, lon_deg=position.lon_deg)
        if line.plane is not None:
            found.append((inf if place is None else place.apart_m, line))
    found.sort(key=lambda pair: pair[0])
    return Listing(tuple(line for _, line in found[:SECTIONS_LIMIT_COUNT]), frozenset(names))


async def list_sections(client: httpx.AsyncClient, address: UnitAddress, position: Position | None) -> Listing | None:
    """Return the sections around a position, or all without one; None if the server did not tell."""
    import httpx

    try:
        box = {} if position is None else {"bbox": bbox_around(position)}
        answer = await client.get(f"{address}/v1/sections", params=box, timeout=_LIST_TIMEOUT_S)
        if answer.status_code != httpx.codes.OK or len(answer.content) > LISTING_LIMIT_BYTES:
            return None
        return listing_of(answer.json(), position)
    except (httpx.HTTPError, ValueError):
        return None
