"""From a surveyed polyline to a section: spline, smoothing, nodes, bank, anchors.

A register's line is a polyline with vertices 1 to 30 m apart, rounded to decimetres. Its curvature means nothing
before it is smoothed. We lay a spline through the vertices, sample it every metre, smooth with a Gaussian along the
line, add back what the same Gaussian finds in the remainder, and keep nodes every few metres. One pass alone would
cut corners: it moves a bend of radius R inwards by sigma^2 / (2 R), 2 m at 25 m; the second leaves
sigma^4 / (4 R^3), 0.16 m. `FitReport` says how far the result lies from the survey.

References:
    Tukey, Exploratory Data Analysis, 1977, "twicing". docs/sections.md holds what the default was measured on.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.alignment import runoff_sigma_m, smoothed_along
from roadgrip.geodesy import anchors_of
from roadgrip.section import (
    BANK_CAP_RATIO,
    LENGTH_LIMITS_M,
    NODES_LIMIT_COUNT,
    BankOrigin,
    Direction,
    RoadSection,
    build_section,
    cross_slope_of_bank,
    inferred_bank_ratio,
)
from roadgrip.spline import evaluate, second_derivatives
from roadgrip.survey import SurveyLine, refusal, reversed_survey
from roadgrip.units import kph_to_mps

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

SMOOTHING_DEFAULTS_M = (3.0, 10.0)
"""The default is one and a half times the mean distance of the vertices, within these: a line that somebody already
fitted to a one-metre grid needs little, a register's polyline needs much."""
SMOOTHING_LIMIT_M = 50.0
GRID_STEP_M = 1.0
SURVEY_LENGTH_LIMIT_M = 200_000.0
VERTEX_GAP_LIMIT_M = 250.0
"""Between vertices farther apart nobody knows where the road runs."""
NODE_STEP_LIMITS_M = (3.0, 8.0)


@dataclass(frozen=True, slots=True)
class ImportRequest:
    """What the person who imports a road decides.

    Attributes:
        section_id: Id of the new section.
        name: What people call it.
        speed_limit_kph: Rated speed; wins over the source's. None means that the source must know it.
        direction: Direction of travel; `AGAINST` drives the source's line backwards.
        reverse: The source's line runs against the register's metres.
        from_m: Where the section begins, along the direction of travel.
        to_m: Where it ends; None means the end of the line.
        smoothing_m: Standard deviation of the Gaussian along the line; zero leaves the spline as it is, None takes
            `SMOOTHING_DEFAULTS_M`.
        bank_cap_ratio: Largest physical bank that is believed.
    """

    section_id: str
    name: str
    speed_limit_kph: float | None = None
    direction: Direction = Direction.WITH
    reverse: bool = False
    from_m: float = 0.0
    to_m: float | None = None
    smoothing_m: float | None = None
    bank_cap_ratio: float = BANK_CAP_RATIO


@dataclass(frozen=True, slots=True)
class FitReport:
    """How the section relates to the survey.

    Attributes:
        survey_length_m: Length of the whole line in the source.
        survey_points_count: Vertices of the source inside the section.
        deviation_rms_m: Root mean square distance of those vertices from the section's line.
        deviation_max_m: The largest.
        smoothing_m: What was used.
        node_step_m: Distance between nodes.
        has_heights: Whether the source knew heights; without them the section is level.
    """

    survey_length_m: float
    survey_points_count: int
    deviation_rms_m: float
    deviation_max_m: float
    smoothing_m: float
    node_step_m: float
    has_heights: bool


@dataclass(frozen=True, slots=True)
class SurveyedCourse:
    """How a surveyed line bends.

    Attributes:
        station_m: Distance along the line, about every metre. (n,)
        curvature_1pm: Left turn positive. (n,)
        vertex_station_m: Of the survey's own points. (k,)
        smoothing_m: Standard deviation of the Gaussian along the line that was used.
    """

    station_m: FloatArray
    curvature_1pm: FloatArray
    vertex_station_m: FloatArray
    smoothing_m: float


def section_of_survey(survey: SurveyLine, request: ImportRequest) -> tuple[RoadSection, FitReport]:
    """Return the section that a surveyed line gives, and how well it fits.

    Without a measured bank the one by the book is inferred from curvature and speed limit, spread along the line as
    a carriageway must be, and marked as inferred.

    Raises:
        SectionError: The speed limit is unknown, the stations lie outside the line, or the geometry is no road.
    """
    speed_limit_mps = kph_to_mps(_speed_limit_kph(survey, request))
    # Against the register's metres means backwards, unless the file itself already runs backwards.
    backwards = request.reverse != (request.direction is Direction.AGAINST)
    line = reversed_survey(survey) if backwards else survey
    origin = np.round(line.points_m[0], 3)
    vertices = line.points_m - origin

    grid, vertex_station, columns = _even_grid(line, vertices)
    smoothing_m = _smoothing_m(request, spacing_m=float(grid[-1]) / (len(vertices) - 1))
    smooth = _smoothed(columns, step_m=grid[1], sigma_m=smoothing_m)
    first, last = _range(request, grid)
    station, smooth = grid[first : last + 1], smooth[first : last + 1]
    curvature = _curvature(smooth)
    step_m = _node_step_m(curvature, length_m=station[-1] - station[0])
    # Knots at equal steps of the grid's station, which is the arc length before smoothing.
    at = np.linspace(station[0], station[-1], max(4, round((station[-1] - station[0]) / step_m) + 1))
    # Along straights between grid points nodes would lie up to 1 / (8 R) inside the bend, 4 mm at 30 m: that shows.
    nodes, _, _ = evaluate(station, smooth[:, :3], second_derivatives(station, smooth[:, :3]), at)
    cross_slope, bank_origin = _cross_slope(
        line,
        smooth,
        curvature,
        step_m=grid[1],
        smoothing_m=smoothing_m,
        speed_limit_mps=speed_limit_mps,
        bank_cap_ratio=request.bank_cap_ratio,
    )

    moved = nodes[0].copy()
    section = build_section(
        section_id=request.section_id,
        name=request.name,
        nodes_m=nodes - moved,
        speed_limit_mps=speed_limit_mps,
        cross_slope_ratio=np.interp(at, station, cross_slope),
        bank_origin=bank_origin,
        direction=request.direction,
        crs=line.crs,
        origin_m=tuple((origin + moved).tolist()),
        bank_cap_ratio=request.bank_cap_ratio,
    )
    if line.crs != "local":
        section = dataclasses.replace(section, anchors=anchors_of(section))
    inside = (vertex_station >= station[0]) & (vertex_station <= station[-1])
    deviation = _deviation_m(section, vertices[inside] - moved)
    report = FitReport(
        survey_length_m=float(grid[-1]),
        survey_points_count=int(inside.sum()),
        deviation_rms_m=float(np.sqrt(np.mean(deviation**2))) if deviation.size else 0.0,
        deviation_max_m=float(deviation.max(initial=0.0)),
        smoothing_m=smoothing_m,
        node_step_m=float(at[1] - at[0]),
        has_heights=survey.has_heights,
    )
    return section, report


def surveyed_course(line: SurveyLine) -> SurveyedCourse:
    """Return how a whole surveyed line bends.

    It is smoothed as `section_of_survey` does where it is not told otherwise: a section cut between two of these
    stations has this curvature.

    Raises:
        SectionError: The line is no road.
    """
    vertices = line.points_m - np.round(line.points_m[0], 3)
    grid, vertex_station, columns = _even_grid(line, vertices)
    smoothing_m = _default_smoothing_m(float(grid[-1]) / (len(vertices) - 1))
    return SurveyedCourse(
        station_m=grid,
        curvature_1pm=_curvature(_smoothed(columns, step_m=grid[1], sigma_m=smoothing_m)),
        vertex_station_m=vertex_station,
        smoothing_m=smoothing_m,
    )


def _speed_limit_kph(survey: SurveyLine, request: ImportRequest) -> float:
    if request.speed_limit_kph is not None:
        if not 3.6 <= request.speed_limit_kph <= 216.0:
            raise refusal(f"a speed limit of {request.speed_limit_kph:g} km/h; give kilometres per hour")
        return request.speed_limit_kph
    known = [limit for limit in survey.speed_limit_kph if limit > 0.0]
    if not known:
        raise refusal("the source does not know the speed limit; give --speed-limit KMH")
    if len(known) > 1:
        limits = ", ".join(f"{limit:g}" for limit in known[:8])
        raise refusal(
            f"the source gives several speed limits ({limits} km/h); cut the section or give --speed-limit KMH"
        )
    if not 3.6 <= known[0] <= 216.0:
        raise refusal(f"the source gives a speed limit of {known[0]:g} km/h; give --speed-limit KMH")
    return known[0]


def _smoothing_m(request: ImportRequest, *, spacing_m: float) -> float:
    if request.smoothing_m is None:
        return _default_smoothing_m(spacing_m)
    if not 0.0 <= request.smoothing_m <= SMOOTHING_LIMIT_M:
        raise refusal(f"smoothing of {request.smoothing_m} m; 0 to {SMOOTHING_LIMIT_M:.0f} m are possible")
    return request.smoothing_m


def _default_smoothing_m(spacing_m: float) -> float:
    low, high = SMOOTHING_DEFAULTS_M
    return min(max(1.5 * spacing_m, low), high)


def _smoothed(columns: FloatArray, *, step_m: float, sigma_m: float) -> FloatArray:
    once = smoothed_along(columns, step_m=step_m, sigma_m=sigma_m)
    return once + smoothed_along(columns - once, step_m=step_m, sigma_m=sigma_m)


def _even_grid(line: SurveyLine, vertices: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return stations every metre, the stations of the vertices, and the columns of the line on those stations.

    Columns are east, north, up and, when it was measured, cross slope or bank.
    """
    chords = np.hypot(*np.diff(vertices[:, :2], axis=0).T)
    if chords.max() > VERTEX_GAP_LIMIT_M:
        widest = int(np.argmax(chords))
        raise refusal(
            f"points {widest + 1} and {widest + 2} lie {chords[widest]:.0f} m apart; the road between is unknown"
        )
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    if not LENGTH_LIMITS_M[0] <= knots[-1] <= SURVEY_LENGTH_LIMIT_M:
        raise refusal(f"the line is {knots[-1]:.1f} m long; {LENGTH_LIMITS_M[0]:.0f} m to 200 km are possible")
    measured = line.cross_slope_ratio if line.cross_slope_ratio is not None else line.bank_ratio
    if len(knots) < 4:
        # Two or three vertices make no cubic; a straight with a corner stays one until it is smoothed.
        more = np.union1d(knots, np.linspace(0.0, knots[-1], 7))
        vertices = np.column_stack([np.interp(more, knots, vertices[:, k]) for k in range(3)])
        measured = None if measured is None else np.asarray(np.interp(more, knots, measured))
        own = np.searchsorted(more, knots)
        knots = more
    else:
        own = np.arange(len(knots))
    second = second_derivatives(knots, vertices)
    fine = np.linspace(0.0, knots[-1], int(np.ceil(knots[-1] / 0.25)) + 1)
    value, first, _ = evaluate(knots, vertices, second, fine)
    # Heights are surveyed worse than positions; a straight between vertices does not overshoot.
    value[:, 2] = np.interp(fine, knots, vertices[:, 2])
    pace = np.hypot(first[:, 0], first[:, 1])
    travelled = np.concatenate([[0.0], np.cumsum(np.diff(fine) * (pace[1:] + pace[:-1]) / 2.0)])
    grid = np.linspace(0.0, travelled[-1], max(8, round(travelled[-1] / GRID_STEP_M) + 1))
    parameter = np.interp(grid, travelled, fine)
    columns = [np.interp(parameter, fine, value[:, k]) for k in range(3)]
    if measured is not None:
        columns.append(np.interp(parameter, knots, measured))
    return grid, np.interp(knots[own], fine, travelled), np.column_stack(columns)


def _range(request: ImportRequest, grid: FloatArray) -> tuple[int, int]:
    to_m = float(grid[-1]) if request.to_m is None else request.to_m
    if not 0.0 <= request.from_m < to_m <= grid[-1] + 1.0:
        raise refusal(f"stations {request.from_m:g} to {to_m:g} m do not lie on a line of {grid[-1]:.1f} m")
    first, last = np.rint(np.array([request.from_m, min(to_m, grid[-1])]) / grid[1]).astype(int)
    if (last - first) * grid[1] < LENGTH_LIMITS_M[0]:
        raise refusal(f"the section would be shorter than {LENGTH_LIMITS_M[0]:.0f} m")
    if (last - first) * grid[1] > LENGTH_LIMITS_M[1]:
        raise refusal(
            f"the section would be longer than {LENGTH_LIMITS_M[1] / 1000:.0f} km; choose a stretch by --from, --to"
        )
    return int(first), int(last)


def _curvature(smooth: FloatArray) -> FloatArray:
    d = np.gradient(smooth[:, :2], axis=0)
    dd = np.gradient(d, axis=0)
    pace = np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-6)
    curvature: FloatArray = (d[:, 0] * dd[:, 1] - d[:, 1] * dd[:, 0]) / pace**3
    # One-sided differences at the ends are off by a whole step.
    curvature[:2], curvature[-2:] = curvature[2], curvature[-3]
    return curvature


def _node_step_m(curvature_1pm: FloatArray, *, length_m: float) -> float:
    """Return an eighth of the tightest radius, within limits: a spline through such nodes keeps the curvature."""
    low, high = NODE_STEP_LIMITS_M
    radius = 1.0 / max(1e-9, float(np.abs(curvature_1pm).max()))
    return float(max(min(max(radius / 8.0, low), high), length_m / (NODES_LIMIT_COUNT - 1)))


def _cross_slope(
    line: SurveyLine,
    smooth: FloatArray,
    curvature_1pm: FloatArray,
    *,
    step_m: float,
    smoothing_m: float,
    speed_limit_mps: float,
    bank_cap_ratio: float,
) -> tuple[FloatArray, BankOrigin]:
    if line.cross_slope_ratio is not None:
        return smooth[:, 3], BankOrigin.MEASURED
    if line.bank_ratio is not None:
        # "Inward" flips its side where the curvature changes sign; a carriageway turns over gradually.
        flipped = cross_slope_of_bank(smooth[:, 3], curvature_1pm)
        return smoothed_along(flipped, step_m=step_m, sigma_m=smoothing_m), BankOrigin.MEASURED
    bank = inferred_bank_ratio(curvature_1pm, speed_limit_mps=speed_limit_mps, bank_cap_ratio=bank_cap_ratio)
    cross_slope = cross_slope_of_bank(bank, curvature_1pm)
    return smoothed_along(cross_slope, step_m=step_m, sigma_m=runoff_sigma_m(speed_limit_mps)), BankOrigin.INFERRED


def _deviation_m(section: RoadSection, points_m: FloatArray) -> FloatArray:
    """Return how far points lie from the section's line, square to it. (n,)"""
    profile = section.profile
    found = np.zeros(len(points_m))
    for i, (x, y, _) in enumerate(points_m):
        dx, dy = x - profile.x_m, y - profile.y_m
        k = int(np.argmin(dx**2 + dy**2))
        found[i] = abs(dy[k] * np.cos(profile.heading_rad[k]) - dx[k] * np.sin(profile.heading_rad[k]))
    return found
