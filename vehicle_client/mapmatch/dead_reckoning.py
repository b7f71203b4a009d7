"""Matching without satellites: the heading a vehicle gained, metre by metre, against the heading the map gains.

Heading is the integral of curvature, so comparing headings compares curvature profiles, without the noise of a
derivative. A curve is recognised by how much, how sharply and after how many metres it turns; a straight tells nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roadgrip.records import Reason, Rejected
from vehicle_client.mapmatch.alignment import (
    EDGE_TOLERANCE_M,
    Alignment,
    MetredDrive,
    alignments,
    mapped_stretch,
    metred_drive,
)
from vehicle_client.mapmatch.evidence import Evidence, evidence_of
from vehicle_client.mapmatch.match import MatchMethod, SectionMatch, section_match
from vehicle_client.mapmatch.waypoints import section_waypoints

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray
    from vehicle_client.mapmatch.driven_line import DrivenLine


AGAIN_LOG_ODDS = 3.0
"""A second passage is as good as the first but for a factor of twenty; what is worse is another road a bit alike."""


class Candidate(NamedTuple):
    """A place where the section may lie, and what speaks for it.

    Attributes:
        alignment: The place.
        evidence: None where nothing does.
    """

    alignment: Alignment
    evidence: Evidence | None

    @property
    def log_odds(self) -> float:
        """Logarithm of the odds that this is the section."""
        return -np.inf if self.evidence is None else self.evidence.log_odds

    @property
    def convincing(self) -> bool:
        """Whether a vehicle may report on it."""
        return self.evidence is not None and self.evidence.convincing


def match_by_dead_reckoning(line: DrivenLine, time_s: FloatArray, section: RoadSection) -> SectionMatch | Rejected:
    """Return where a drive passed a section, from the shape of its line alone; the latest passage if there are several.

    The confidence is the probability of `Evidence`. A road that is straight, or a circle without beginning and end,
    cannot be recognised and is refused.

    Args:
        line: From `driven_line`; up to ten minutes and more.
        time_s: Of its samples. (n,)
        section: The map.

    Returns:
        The match, or why there is none: PASSAGE_ABORTED if the drive is shorter than the section, or follows it
        beyond its half and ends before it does; else WRONG_ROAD.
    """
    found = _matched(line, time_s, section)
    if isinstance(found, SectionMatch) or line.course_rad is None:
        return found
    # A lateral accelerometer that lies bends the course, not the heading.
    by_nose = _matched(replace(line, course_rad=None), time_s, section)
    return by_nose if isinstance(by_nose, SectionMatch) else found


def _matched(line: DrivenLine, time_s: FloatArray, section: RoadSection) -> SectionMatch | Rejected:
    drive = metred_drive(line, time_s)
    length = section.length_m
    driven = 0.0 if drive is None else drive.length_m
    if drive is None or driven < length - EDGE_TOLERANCE_M:
        return Rejected(Reason.PASSAGE_ABORTED, f"drove {driven:.0f} m, the section is {length:.0f} m long")
    found = candidates(drive, section, length_m=length)
    chosen = _latest(found, length_m=length)
    if chosen is not None and chosen.evidence is not None:
        place = chosen.alignment
        missing = max(-place.shift_m, place.shift_m + place.scale_ratio * length - driven)
        if missing > EDGE_TOLERANCE_M:
            return Rejected(Reason.PASSAGE_ABORTED, f"the trace lacks {missing:.0f} m at an end of the section")
        return section_match(
            time_s,
            (line.distance_m - place.shift_m) / place.scale_ratio,
            length_m=length,
            confidence_frac=chosen.evidence.confidence_frac,
            position_std_m=place.position_std_m,
            method=MatchMethod.DEAD_RECKONING,
        )
    if _ends_on_the_way(drive, section):
        return Rejected(Reason.PASSAGE_ABORTED, "the drive follows the section to its own end, before the section's")
    best = max(found, key=lambda candidate: candidate.log_odds)
    if best.evidence is None:
        best = min(found, key=lambda candidate: candidate.alignment.residual_rms_rad)
        return Rejected(
            Reason.WRONG_ROAD, f"headings differ by {best.alignment.residual_rms_rad:.3f} rad where they fit best"
        )
    return Rejected(Reason.WRONG_ROAD, best.evidence.told)


def candidates(drive: MetredDrive, section: RoadSection, *, length_m: float) -> list[Candidate]:
    """Return the places where the first `length_m` of a section may lie, in the order of the drive; at least one.

    Args:
        drive: At least about as long.
        section: The map.
        length_m: How much of it.
    """
    stretch = mapped_stretch(section.profile, length_m=length_m)
    places = alignments(drive, stretch)
    waypoints = section_waypoints(section)
    return [Candidate(place, evidence_of(drive, stretch, waypoints, place)) for place in places]


def _latest(found: list[Candidate], *, length_m: float) -> Candidate | None:
    """Return the last place that is about as convincing as the best; of places that overlap, the better one."""
    convincing = sorted((c for c in found if c.convincing), key=lambda candidate: -candidate.log_odds)
    convincing = [c for c in convincing if c.log_odds >= convincing[0].log_odds - AGAIN_LOG_ODDS]
    kept: list[Candidate] = []
    for candidate in convincing:
        if all(abs(candidate.alignment.shift_m - other.alignment.shift_m) > 0.9 * length_m for other in kept):
            kept.append(candidate)
    return max(kept, key=lambda candidate: candidate.alignment.shift_m, default=None)


def _ends_on_the_way(drive: MetredDrive, section: RoadSection) -> bool:
    """Return whether the drive follows the section from its start, as far as the drive goes, beyond the half."""
    half = section.length_m / 2.0
    start = _latest(candidates(drive, section, length_m=half), length_m=half)
    if start is None:
        return False
    reached = min(section.length_m, (drive.length_m - start.alignment.shift_m) / start.alignment.scale_ratio)
    return any(c.convincing for c in candidates(drive, section, length_m=max(half, reached)))
