"""The two pictures of the matching: errors and acceptance, and one drive laid over its map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bench.onboard.matching_drives import Driven
from bench.validation.picture import OURS, QUIET, THEORY, label, legend, line, panels, write
from roadgrip.units import FloatArray
from vehicle_client.mapmatch.alignment import alignments, mapped_stretch, metred_drive, value_at
from vehicle_client.mapmatch.waypoints import section_waypoints

EXAMPLE_WAYPOINTS_COUNT = 3


def draw_errors(folder: Path, exit_error_m: FloatArray, accepted_frac: Mapping[str, float]) -> str:
    """Draw where sections were thought to end, and which foreign maps were accepted.

    Args:
        folder: Where the picture goes.
        exit_error_m: True station less the length where the client saw the end. (n,)
        accepted_frac: Share by kind of map.
    """
    figure, (left, right) = panels(1, 2, title="Without satellites")
    left.hist(exit_error_m, bins=np.arange(-8.0, 8.01, 0.5).tolist(), color=OURS)
    label(left, f"End of the section, {len(exit_error_m)} roads", x="true station where it was seen, m", y="drives")
    names = list(accepted_frac)[::-1]
    right.barh(names, [100.0 * accepted_frac[name] for name in names], color=OURS, height=0.6)
    for k, name in enumerate(names):
        right.text(100.0 * accepted_frac[name], k, f" {accepted_frac[name]:.2%}", va="center", fontsize=8, color=QUIET)
    right.set_xlim(0.0, 130.0 * max(accepted_frac.values()))
    label(right, "Foreign maps accepted", x="%", y="")
    return write(figure, folder, "matching")


def draw_example(folder: Path, drives: Sequence[Driven]) -> str:
    """Draw curvature, heading and height of one drive over those of its map, its waypoints marked."""
    drive = next(d for d in drives if len(section_waypoints(d.road_map).station_m) >= EXAMPLE_WAYPOINTS_COUNT)
    section, leg = drive.road_map, drive.leg
    metred = metred_drive(leg.line, leg.time_s)
    if metred is None or metred.height_m is None:
        message = "the example drive stood still"
        raise ValueError(message)
    stretch = mapped_stretch(section.profile, length_m=section.length_m)
    place = min(alignments(metred, stretch), key=lambda candidate: candidate.residual_rms_rad)
    waypoints = section_waypoints(section)
    driven_m = np.arange(0.0, metred.length_m)
    station = (driven_m - place.shift_m) / place.scale_ratio
    level = value_at(metred.height_m, np.array([place.shift_m]))[0]
    mean_heading = float(np.mean(value_at(metred.heading_rad, place.driven_m(stretch.station_m))))
    figure, (upper, middle, lower) = panels(1, 3, title="One drive over its map")
    for axes, mapped, seen in (
        (upper, 1e3 * stretch.curvature_1pm, 1e3 * value_at(metred.curvature_1pm, driven_m)),
        (middle, stretch.heading_rad, value_at(metred.heading_rad, driven_m) - mean_heading),
        (lower, stretch.height_m, value_at(metred.height_m, driven_m) - level),
    ):
        line(axes, stretch.station_m, mapped, THEORY, linewidth=3.0, alpha=0.5)
        line(axes, station, seen, OURS)
    upper.plot(waypoints.station_m, 1e3 * waypoints.curvature_1pm, "o", color=THEORY, markersize=5)
    label(upper, "Curvature and waypoints", x="station, m", y="1/km")
    label(middle, "Heading", x="station, m", y="rad")
    label(lower, "Height", x="station, m", y="m")
    legend(lower, ("map", THEORY), ("drive", OURS))
    return write(figure, folder, "matching-example")
