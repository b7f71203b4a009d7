"""Where a drive passed a section, by position fixes and by motion, and whom to believe where they differ.

Fixes come first. They find the section even where its shape says nothing, and a neighbouring road of the same shape is
told by them alone. Motion (odometer and gyro against the map's shape) is asked where fixes are missing or refuse, and
where they would be believed but lag behind the bends. Motion outvotes fixes that refuse only if it finds the section
convincingly *and* the fixes do what no car on another road makes them do:

- at least a quarter of them lie where motion puts the car, and among each other they contradict the car's own motion
  (a jump, a drift: no road leads from here to there); or
- all are off by one and the same vector, sideways now and along the road then, as no neighbouring road is.

Fixes at a steady distance beside the section are another road, whatever the motion says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.geodesy import frame_of
from roadgrip.order_statistics import median, quantile
from roadgrip.records import Reason, Rejected
from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.plausibility import Finding, Level, Sensor
from vehicle_client.mapmatch.dead_reckoning import match_by_dead_reckoning
from vehicle_client.mapmatch.gnss import (
    APART_LIMIT_M,
    live_fixes,
    match_by_gnss,
    poor_along,
    positions_usable,
    readable_fixes,
)
from vehicle_client.mapmatch.heading import heading_findings, heading_fit
from vehicle_client.mapmatch.match import SectionMatch

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import GnssTrack
    from vehicle_client.mapmatch.driven_line import DrivenLine

    ComplexArray = NDArray[np.complex128]

SHIFT_LIMIT_M = 6.0
SHIFT_DEVIATIONS_COUNT = 2.5
"""A match so far before or behind the bends, and so surely, is not where the car was. Good fixes: 5 m."""
AROUND_S = 10.0
"""Fixes so long before and after the passage have a say, too."""
ON_IT_FRAC, MOSTLY_FRAC = 0.25, 0.5
STEP_LIMIT_M, STEP_S = 10.0, 1.0
"""Two fixes within a second differ from what wheels and gyro say by less."""
SHAPE_RMS_LIMIT_M = 6.0
"""So near the fixes lie to the car's own line, laid over them as it is."""
AS_ONE_RMS_M = 5.0
BESIDE_SPREAD_M = 10.0
"""Sideways distances from a neighbouring road spread less."""
FAR_LIMIT_M = 100.0
ROLLING_RATIO = Level(0.03, 0.10)
"""Wheels against the receiver's speed. Good ones: 0.02."""
LENGTH_RATIO = Level(0.012, 0.10)
"""The section by the wheels against the map, where the bends tell when it began and ended. Good ones: 0.006."""
CHORD_S, CHORD_MIN_M = 2.0, 4.0
_FIXES_MIN_COUNT = 5
_STRIDE_COUNT = 10


@dataclass(frozen=True, slots=True)
class Placing:
    """Where a drive passed a section, or why it did not.

    Attributes:
        outcome: The match, or the refusal.
        gnss_poor: Whether fixes were there along the section, but too few or too bad to be relied on.
        findings: What fixes and map say of the car's own sensors.
    """

    outcome: SectionMatch | Rejected
    gnss_poor: bool = False
    findings: tuple[Finding, ...] = ()


def placed(gnss: GnssTrack | None, line: DrivenLine, time_s: FloatArray, section: RoadSection) -> Placing:
    """Return where a drive passed a section.

    Args:
        gnss: Fixes, if there are any.
        line: From `driven_line`.
        time_s: Of its samples. (n,)
        section: The map.

    Raises:
        SectionError: The section's anchors cannot be used.
    """
    if gnss is None or len(section.anchors) < 2 or len(gnss.time_s) == 0:
        return _by_motion(line, time_s, section)
    gnss = readable_fixes(gnss)
    if not positions_usable(gnss, section):
        return _by_motion(line, time_s, section, gnss_poor=True)
    found = match_by_gnss(gnss, line, time_s, section)
    if isinstance(found, SectionMatch):
        return _checked(found, gnss, line, time_s, section)
    reckoned = _by_motion(line, time_s, section, gnss_poor=True)
    if not isinstance(reckoned.outcome, SectionMatch):
        return reckoned if found is None else Placing(found)
    if _fixes_allow(gnss, line, time_s, reckoned.outcome, section, refused=found is not None):
        return reckoned
    return Placing(found or Rejected(Reason.WRONG_ROAD, "the few fixes lie elsewhere"))


def _by_motion(line: DrivenLine, time_s: FloatArray, section: RoadSection, *, gnss_poor: bool = False) -> Placing:
    """Return the placing by dead reckoning, with what the section's length says of the wheels."""
    found = match_by_dead_reckoning(line, time_s, section)
    if not isinstance(found, SectionMatch):
        return Placing(found, gnss_poor=gnss_poor)
    travelled = float(np.ptp(np.interp([found.entry_s, found.exit_s], time_s, line.distance_m)))
    longer = abs(section.length_m / max(travelled, 1.0) - 1.0)
    wheels = Finding(Sensor.WHEELS, "measures the section otherwise than the map, as a share", longer, LENGTH_RATIO)
    return Placing(found, gnss_poor=gnss_poor, findings=(wheels,))


def _checked(
    found: SectionMatch, gnss: GnssTrack, line: DrivenLine, time_s: FloatArray, section: RoadSection
) -> Placing:
    """Return the placing by fixes, unless the bends say that they lag; with what it says of the car's sensors."""
    poor = poor_along(gnss, line, time_s, found)
    fit = heading_fit(line, time_s, found, section)
    if fit is not None and abs(fit.shift_m) > max(SHIFT_LIMIT_M, SHIFT_DEVIATIONS_COUNT * fit.shift_std_m):
        reckoned = _by_motion(line, time_s, section, gnss_poor=True)
        if isinstance(reckoned.outcome, SectionMatch):
            return reckoned
        poor = True
    rolling, receiver_off = _rolling(found, gnss, line, time_s, section)
    return Placing(found, gnss_poor=poor or receiver_off, findings=(*heading_findings(fit), *rolling))


def _fixes_allow(
    gnss: GnssTrack,
    line: DrivenLine,
    time_s: FloatArray,
    match: SectionMatch,
    section: RoadSection,
    *,
    refused: bool,
) -> bool:
    """Return whether motion may place a drive that the fixes do not place.

    Args:
        gnss: The fixes.
        line: The drive.
        time_s: Of its samples. (n,)
        match: Where motion places it.
        section: The map.
        refused: Whether the fixes say that it was not on the section; else they say too little.
    """
    used = live_fixes(gnss, line, time_s)
    used &= (gnss.time_s > match.entry_s - AROUND_S) & (gnss.time_s < match.exit_s + AROUND_S)
    if not used.any():
        return not refused
    at_s = gnss.time_s[used]
    x, y = frame_of(section).to_local(gnss.lat_deg[used], gnss.lon_deg[used])
    fixes = x + 1j * y
    own = np.interp(at_s, time_s, line.x_m) + 1j * np.interp(at_s, time_s, line.y_m)
    reckoned, ahead = _on_the_map(own, line, time_s, match, section)
    off = fixes - reckoned
    on_it_frac = float(np.mean(np.abs(off) <= APART_LIMIT_M))
    if not refused and on_it_frac >= MOSTLY_FRAC:
        return True
    if used.sum() < _FIXES_MIN_COUNT:
        return False
    if on_it_frac >= ON_IT_FRAC and _against_motion(fixes, own, at_s):
        return True
    middle = complex(median(off.real), median(off.imag))
    as_one = float(np.sqrt(np.mean(np.abs(off - middle) ** 2))) <= AS_ONE_RMS_M
    beside = (off * ahead.conj()).imag
    spread = quantile(beside, 0.9) - quantile(beside, 0.1)
    return as_one and abs(middle) <= FAR_LIMIT_M and spread > BESIDE_SPREAD_M


def _on_the_map(
    own: ComplexArray, line: DrivenLine, time_s: FloatArray, match: SectionMatch, section: RoadSection
) -> tuple[ComplexArray, ComplexArray]:
    """Return where the car's own line, laid over the map as motion matched it, puts some of its points, and its way.

    Args:
        own: Points of the car's own line. (k,)
        line: The drive.
        time_s: Of its samples. (n,)
        match: From dead reckoning.
        section: The map.
    """
    profile = section.profile
    inside = np.flatnonzero(match.inside(time_s))[::_STRIDE_COUNT]
    driven = line.x_m[inside] + 1j * line.y_m[inside]
    station = match.station_m[inside]
    mapped = np.interp(station, profile.station_m, profile.x_m) + 1j * np.interp(
        station, profile.station_m, profile.y_m
    )
    turned, shift = _laid_over(driven, mapped)
    # Inside the map is the better line: the car's own one wanders off with gyro and sideslip.
    nearest = np.abs(own[:, None] - driven).argmin(axis=1)
    placed_at = turned * own + shift + (mapped - (turned * driven + shift))[nearest]
    heading = np.interp(station, profile.station_m, profile.heading_rad)[nearest]
    return placed_at, np.exp(1j * heading)


def _laid_over(line: ComplexArray, target: ComplexArray) -> tuple[complex, complex]:
    """Return the turn and the shift that lay a line over a target best, as it is.

    References:
        Umeyama, Least-squares estimation of transformation parameters between two point patterns (1991), in the
        plane and without scale.
    """
    product = complex(np.vdot(line - line.mean(), target - target.mean()))
    turn = product / abs(product) if abs(product) > 0.0 else 1.0 + 0.0j
    return turn, complex(target.mean() - turn * line.mean())


def _against_motion(fixes: ComplexArray, own: ComplexArray, at_s: FloatArray) -> bool:
    """Return whether fixes contradict the car's own motion: by a step, or by the shape of the whole."""
    turn, shift = _laid_over(own, fixes)
    off = fixes - (turn * own + shift)
    step = np.abs(np.diff(off))[np.diff(at_s) <= STEP_S]
    if step.size and float(step.max()) > STEP_LIMIT_M:
        return True
    return float(np.sqrt(np.mean(np.abs(off) ** 2))) > SHAPE_RMS_LIMIT_M


def _rolling(
    match: SectionMatch, gnss: GnssTrack, line: DrivenLine, time_s: FloatArray, section: RoadSection
) -> tuple[tuple[Finding, ...], bool]:
    """Return how far the wheels are from the receiver's speed and positions, or that these two are at odds.

    Positions tell the speed by the distance between two of them, two seconds apart, over that of the car's own line.
    """
    used = live_fixes(gnss, line, time_s) & (gnss.time_s >= match.entry_s) & (gnss.time_s <= match.exit_s)
    if used.sum() < _FIXES_MIN_COUNT:
        return (), False
    at_s = gnss.time_s[used]
    by_positions = _chords_ratio(gnss.where(used), line, time_s, section) - 1.0
    doppler = gnss.speed_mps
    if doppler is None or not np.isfinite(doppler[used]).any():
        return (
            Finding(Sensor.WHEELS, "differs from the positions', as a share", abs(by_positions), ROLLING_RATIO),
        ), False
    told = np.isfinite(doppler[used])
    reach = 10 * SAMPLE_S
    wheels = np.interp(at_s + reach, time_s, line.distance_m) - np.interp(at_s - reach, time_s, line.distance_m)
    by_speed = float(np.mean(doppler[used][told])) * 2.0 * reach / max(float(np.mean(wheels[told])), 1e-3) - 1.0
    if abs(by_speed - by_positions) >= ROLLING_RATIO.doubtful_value:
        return (), True
    return (Finding(Sensor.WHEELS, "differs from the receiver's, as a share", abs(by_speed), ROLLING_RATIO),), False


def _chords_ratio(gnss: GnssTrack, line: DrivenLine, time_s: FloatArray, section: RoadSection) -> float:
    """Return the distance between fixes two seconds apart over what wheels and gyro say of it; the median of all."""
    partner = np.searchsorted(gnss.time_s, gnss.time_s + CHORD_S)
    first = np.flatnonzero(partner < len(gnss.time_s))
    if first.size == 0:
        return 1.0
    x, y = frame_of(section).to_local(gnss.lat_deg, gnss.lon_deg)
    own_x, own_y = np.interp(gnss.time_s, time_s, line.x_m), np.interp(gnss.time_s, time_s, line.y_m)
    by_fixes, by_wheels = (
        np.hypot(east[partner[first]] - east[first], north[partner[first]] - north[first])
        for east, north in ((x, y), (own_x, own_y))
    )
    return median(by_fixes / np.maximum(by_wheels, CHORD_MIN_M))
