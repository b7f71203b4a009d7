"""Matching with satellites: fixes give the place, dead reckoning gives what lies between them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.geodesy import frame_of
from roadgrip.order_statistics import median, quantile
from roadgrip.records import Reason, Rejected
from vehicle_client.mapmatch.match import MatchMethod, SectionMatch, section_match

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from roadgrip.section import RoadSection, SectionProfile
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.trace import GnssTrack
    from vehicle_client.mapmatch.driven_line import DrivenLine

ACCURACY_LIMIT_M = 25.0
"""Fixes that call themselves worse are left out."""
APART_LIMIT_M = 15.0
"""A fix may lie so far from where the vehicle is on the map; two lanes and a few metres of receiver and odometer."""
AGREEING_MIN_FRAC = 0.7
"""So many fixes must lie that near."""
END_FRAC = 0.1
CROSSED_MIN_FRAC = 0.5
"""Half of the fixes along the first and the last tenth must agree: on a ramp a car leaves late, and yet leaves."""
AGREEING_WELL_FRAC = 0.9
ACCURACY_POOR_M = 10.0
SILENT_LIMIT_S = 2.5
USED_MIN_FRAC = 0.8
MOVED_M = 1.0
"""Farther than this between two fixes, and the second must differ from the first."""
NEAR_M = 40.0
"""Fixes farther than this from the centre line are not on it."""
BEYOND_M = 60.0
"""How far the road is continued straight beyond its ends."""
EDGE_TOLERANCE_M = 8.0
FIXES_MIN_COUNT = 5
UNSEEN_LIMIT_FRAC = 0.7
"""Without a fix for so much of the section's length, a passage may have gone unseen."""
COVERAGE_MIN_FRAC = 0.3
"""Dropouts are bridged, but the fixes must span this share of the section."""
SPEED_LIMIT_MPS = 150.0
SCALE_STD_RATIO = 0.01
END_RATIO = 2.2
"""A straight line over the odometer is wrong where bends are cut, most at its ends: so many times the median there."""
TREND_MIN_RATIO = 0.5
"""Stations that fall by more than this per metre driven: the other direction."""
_JUMP_M = 60.0
_ROUNDS_COUNT = 5
_PAIRS_LIMIT_COUNT = 2_000_000
_POINTS_AT_ONCE_COUNT = 48


def readable_fixes(gnss: GnssTrack) -> GnssTrack:
    """Return the fixes that are numbers and in the order of time; speeds that no car drives are NaN."""
    numbers = np.isfinite(gnss.time_s) & (np.abs(gnss.lat_deg) <= 90.0) & (np.abs(gnss.lon_deg) <= 180.0)
    kept = gnss if numbers.all() else gnss.where(numbers)
    if len(kept.time_s) > 1 and not (np.diff(kept.time_s) > 0.0).all():
        latest = np.maximum.accumulate(kept.time_s)
        kept = kept.where(np.concatenate([[True], kept.time_s[1:] > latest[:-1]]))
    if kept.speed_mps is None:
        return kept
    driven = (kept.speed_mps >= 0.0) & (kept.speed_mps <= SPEED_LIMIT_MPS)
    return replace(kept, speed_mps=np.where(driven, kept.speed_mps, np.nan))


def positions_usable(gnss: GnssTrack | None, section: RoadSection) -> bool:
    """Return whether a track and a map can be brought together: enough good fixes, and anchors on the map."""
    if gnss is None or len(section.anchors) < 2:
        return False
    return int(_good(gnss).sum()) >= FIXES_MIN_COUNT


def match_by_gnss(
    gnss: GnssTrack, line: DrivenLine, time_s: FloatArray, section: RoadSection
) -> SectionMatch | Rejected | None:
    """Return where a drive passed a section, from position fixes.

    Stations of the fixes are fitted by a robust straight line over the odometer, so that noise averages out and
    dropouts are bridged. The confidence is the share of fixes along the section that agree with that line.

    Args:
        gnss: Fixes, at least some good ones.
        line: From `driven_line`.
        time_s: Of the samples of the line. (n,)
        section: The map, with anchors.

    Returns:
        The match; or WRONG_ROAD if the drive stays away from the section or runs against its direction; or
        PASSAGE_ABORTED if start or end is missing or the vehicle turned round; or None if the fixes near the section
        are too few to say.

    Raises:
        SectionError: The section's anchors cannot be used.
    """
    good = live_fixes(gnss, line, time_s)
    if good.sum() < FIXES_MIN_COUNT:
        return None
    length, profile = section.length_m, section.profile
    x, y = frame_of(section).to_local(gnss.lat_deg[good], gnss.lon_deg[good])
    station, lateral = _projected(x, y, profile)
    travelled = np.interp(gnss.time_s[good], time_s, line.distance_m)
    near = (np.abs(lateral) <= NEAR_M) & (station > -BEYOND_M) & (station < length + BEYOND_M)
    near = _one_pass(near, station, travelled)
    within = near & (station >= 0.0) & (station <= length)
    if within.sum() < FIXES_MIN_COUNT:
        ends = line.distance_m[[0, -1]]
        unseen = float(np.diff(np.concatenate([ends[:1], travelled, ends[1:]])).max())
        if within.any() or unseen > UNSEEN_LIMIT_FRAC * length:
            return None
        return Rejected(Reason.WRONG_ROAD, "the fixes stay away from the section")
    if _trend(station[near], travelled[near]) < -TREND_MIN_RATIO:
        return Rejected(Reason.WRONG_ROAD, "driven against the direction of the section")
    shift, scale = _odometer_fit(station[near], travelled[near])
    reckoned = shift + scale * travelled
    along = (reckoned >= 0.0) & (reckoned <= length)
    if along.sum() < FIXES_MIN_COUNT or float(np.ptp(reckoned[along])) < COVERAGE_MIN_FRAC * length:
        return None
    # How far every fix of the passage lies from where the odometer puts the vehicle on the map.
    apart = np.hypot(
        x - np.interp(reckoned, profile.station_m, profile.x_m), y - np.interp(reckoned, profile.station_m, profile.y_m)
    )[along]
    agreeing = apart <= APART_LIMIT_M
    agreeing_frac = float(np.mean(agreeing))
    ends = reckoned[along] / length
    crossed_frac = min(
        float(np.mean(agreeing[end])) if end.any() else 1.0 for end in (ends < END_FRAC, ends > 1.0 - END_FRAC)
    )
    stations = shift + scale * line.distance_m
    refusal = _refusal(
        stations, lateral[along], agreeing_frac=agreeing_frac, crossed_frac=crossed_frac, length_m=length
    )
    if refusal is not None:
        return refusal
    return section_match(
        time_s,
        stations,
        length_m=length,
        confidence_frac=agreeing_frac,
        # Receiver errors wander over minutes: within one passage they hardly average out.
        position_std_m=float(
            np.hypot(END_RATIO * median(np.abs(station - reckoned)[along]), median(gnss.accuracy_m[good]))
        ),
        method=MatchMethod.GNSS,
    )


def _refusal(
    stations_m: FloatArray, lateral_m: FloatArray, *, agreeing_frac: float, crossed_frac: float, length_m: float
) -> Rejected | None:
    """Return why a fitted drive is no passage of the section, if it is none."""
    if agreeing_frac < AGREEING_MIN_FRAC:
        aside = quantile(np.abs(lateral_m), 0.7)
        if aside > APART_LIMIT_M:
            return Rejected(Reason.WRONG_ROAD, f"the fixes lie {aside:.0f} m beside the section")
        return Rejected(Reason.PASSAGE_ABORTED, "the vehicle turned round or left the section on the way")
    if crossed_frac < CROSSED_MIN_FRAC:
        return Rejected(
            Reason.PASSAGE_ABORTED, "the fixes leave the section before its end, or join it after its start"
        )
    if stations_m[0] > EDGE_TOLERANCE_M:
        return Rejected(Reason.PASSAGE_ABORTED, f"the trace begins {stations_m[0]:.0f} m after the start")
    if stations_m[-1] < length_m - EDGE_TOLERANCE_M:
        return Rejected(Reason.PASSAGE_ABORTED, f"the trace ends {length_m - stations_m[-1]:.0f} m before the end")
    return None


def live_fixes(gnss: GnssTrack, line: DrivenLine, time_s: FloatArray) -> BoolArray:
    """Return which fixes lie within the trace, are good by their own word, and are not the last one again. (k,)

    A receiver that lost the satellites may repeat its last position, bit for bit, while the wheels turn.
    """
    good: BoolArray = _good(gnss) & (gnss.time_s >= time_s[0]) & (gnss.time_s <= time_s[-1])
    same = (np.diff(gnss.lat_deg) == 0.0) & (np.diff(gnss.lon_deg) == 0.0)
    if same.any():
        moved = np.diff(np.interp(gnss.time_s, time_s, line.distance_m)) > MOVED_M
        good[1:] &= ~(same & moved)
    return good


def poor_along(gnss: GnssTrack, line: DrivenLine, time_s: FloatArray, match: SectionMatch) -> bool:
    """Return whether the fixes along a matched section are sparse, inaccurate by their own word, or disagree.

    That is: more than 2.5 s without a fix that can be used, more than a fifth of them unusable, a median accuracy
    over 10 m, or more than a tenth that lie elsewhere than the odometer says.
    """
    along = (gnss.time_s >= match.entry_s) & (gnss.time_s <= match.exit_s)
    used = along & live_fixes(gnss, line, time_s)
    times = np.concatenate([[match.entry_s], gnss.time_s[used], [match.exit_s]])
    if not used.any() or float(np.diff(times).max()) > SILENT_LIMIT_S:
        return True
    return (
        int(used.sum()) < USED_MIN_FRAC * int(along.sum())
        or median(gnss.accuracy_m[used]) > ACCURACY_POOR_M
        or match.confidence_frac < AGREEING_WELL_FRAC
    )


def _good(gnss: GnssTrack) -> BoolArray:
    finite = np.isfinite(gnss.lat_deg) & np.isfinite(gnss.lon_deg) & np.isfinite(gnss.time_s)
    return finite & (gnss.accuracy_m >= 0.0) & (gnss.accuracy_m <= ACCURACY_LIMIT_M)


def _trend(station_m: FloatArray, travelled_m: FloatArray) -> float:
    """Return how many metres of the section a metre driven makes; 0 for a vehicle that stands."""
    driven = travelled_m - travelled_m.mean()
    power = float(driven @ driven)
    return float(driven @ station_m) / power if power > 1.0 else 0.0


def _projected(x_m: FloatArray, y_m: FloatArray, profile: SectionProfile) -> tuple[FloatArray, FloatArray]:
    """Return station and lateral offset (left positive) of points; beyond its ends the road goes on straight."""
    # A fix every 10 cm along 10 km would be 10^9 pairs; the nearest point is searched on a thinned line first.
    stride = max(1, len(x_m) * len(profile.station_m) // _PAIRS_LIMIT_COUNT)
    index = np.arange(0, len(profile.station_m), stride)
    nearest = index[_nearest(x_m, y_m, line_x_m=profile.x_m[index], line_y_m=profile.y_m[index])]
    for _ in range(4 if stride > 1 else 2):
        heading = profile.heading_rad[nearest]
        dx, dy = x_m - profile.x_m[nearest], y_m - profile.y_m[nearest]
        along = dx * np.cos(heading) + dy * np.sin(heading)
        lateral = dy * np.cos(heading) - dx * np.sin(heading)
        station = profile.station_m[nearest] + along
        nearest = np.clip(np.searchsorted(profile.station_m, station), 0, len(profile.station_m) - 1)
    return station, lateral


def _nearest(x_m: FloatArray, y_m: FloatArray, *, line_x_m: FloatArray, line_y_m: FloatArray) -> NDArray[np.intp]:
    """Return which point of a line lies nearest to each of other points. (n,)"""
    points = np.column_stack([x_m, y_m])
    # The square of a distance, but for the part that is the same for every point of the line.
    twice, own = -2.0 * np.stack([line_x_m, line_y_m]), line_x_m**2 + line_y_m**2
    nearest = np.empty(len(points), dtype=np.intp)
    # Some at a time: all pairs at once would be megabytes that the system hands out page by page.
    for start in range(0, len(points), _POINTS_AT_ONCE_COUNT):
        here = slice(start, start + _POINTS_AT_ONCE_COUNT)
        nearest[here] = np.argmin(points[here] @ twice + own, axis=1)
    return nearest


def _one_pass(near: BoolArray, station_m: FloatArray, travelled_m: FloatArray) -> BoolArray:
    """Return the longest stretch of fixes near the section that is one pass: no gap in which much else was driven."""
    index = np.flatnonzero(near)
    if len(index) == 0:
        return near
    # Between two fixes of one pass the vehicle drives about what its station gains.
    detour = np.abs(np.diff(travelled_m[index]) - np.diff(station_m[index]))
    pieces = np.split(index, np.flatnonzero((detour > _JUMP_M) & (np.diff(index) > 1)) + 1)
    longest = max(pieces, key=lambda piece: float(np.ptp(station_m[piece])))
    mask = np.zeros_like(near)
    mask[longest] = True
    return mask


def _odometer_fit(station_m: FloatArray, travelled_m: FloatArray) -> tuple[float, float]:
    """Return shift and scale of station = shift + scale * travelled, outliers weighted down.

    References:
        Iteratively reweighted least squares with Huber's weights; the scale has a prior around 1.
    """
    middle = float(travelled_m.mean())
    at = travelled_m - middle
    shift = median(station_m - travelled_m) + middle
    scale = 1.0
    for _ in range(_ROUNDS_COUNT):
        residual = station_m - shift - scale * at
        size = max(0.5, 1.5 * median(np.abs(residual)))
        weight = np.minimum(1.0, size / np.maximum(np.abs(residual), 1e-9))
        centre = float(np.average(at, weights=weight))
        power = float(np.sum(weight * (at - centre) ** 2))
        prior = size**2 * len(at) / 10.0 / SCALE_STD_RATIO**2
        gain = float(np.sum(weight * (at - centre) * (station_m - at)))
        scale = 1.0 + gain / (power + prior)
        shift = float(np.average(station_m - scale * at, weights=weight))
    return shift - scale * middle, scale
