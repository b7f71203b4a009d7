"""GeoJSON (RFC 7946): LineString and MultiLineString, alone, in a Feature or in a FeatureCollection."""

from __future__ import annotations

import re
from typing import Any

from roadgrip.survey import PIECES_LIMIT_COUNT, POINTS_LIMIT_COUNT, SurveyLine, joined, refusal, survey_line

WGS84 = "EPSG:4326"


def survey_of_geojson(raw: Any, *, crs: str | None = None) -> SurveyLine:
    """Return the line of a decoded GeoJSON text.

    A property `speed_limit_kmh` of a feature is taken as its speed limit.

    Args:
        raw: The decoded JSON.
        crs: Coordinate reference; left out, that of the file, which is WGS 84 unless a member `crs` (abolished, but
            still written) names another.

    Raises:
        SectionError: There is no line in it, or what there is does not form one line.
    """
    if not isinstance(raw, dict):
        raise refusal("GeoJSON is an object with a `type`")
    crs = crs or _crs_member(raw)
    pieces = [
        survey_line(points, crs=crs, speed_limits_kph=limits)
        for geometry, limits in _geometries(raw)
        for points in _lines(geometry)
    ]
    return joined(pieces)


def _crs_member(raw: dict[str, Any]) -> str:
    member = raw.get("crs")
    properties = member.get("properties") if isinstance(member, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if member is None:
        return WGS84
    if isinstance(name, str):
        if name.upper().endswith("CRS84"):
            return WGS84
        match = re.fullmatch(r"(?:urn:ogc:def:crs:)?EPSG:[^:]{0,10}:?(\d{4,5})", name, re.IGNORECASE | re.ASCII)
        if match:
            return f"EPSG:{match[1]}"
    raise refusal(f"the member crs names no reference this software knows: {member!s:.60}")


def _geometries(raw: dict[str, Any]) -> list[tuple[dict[str, Any], list[float]]]:
    kind = raw.get("type")
    if kind == "FeatureCollection":
        features = raw.get("features")
        if not isinstance(features, list) or len(features) > PIECES_LIMIT_COUNT:
            raise refusal(f"a FeatureCollection needs a list `features` of at most {PIECES_LIMIT_COUNT}")
        if not all(isinstance(f, dict) and f.get("type") == "Feature" for f in features):
            raise refusal("a FeatureCollection holds Features")
        return [found for feature in features for found in _geometries(feature)]
    if kind == "Feature":
        geometry = raw.get("geometry")
        if not isinstance(geometry, dict):
            raise refusal("a Feature needs a geometry")
        return [(geometry, _limits(raw.get("properties")))]
    return [(raw, [])]


def _limits(properties: Any) -> list[float]:
    value = properties.get("speed_limit_kmh") if isinstance(properties, dict) else None
    if value is None:
        return []
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 300:
        raise refusal(f"speed_limit_kmh is {value!s:.20}, not a speed")
    return [float(value)]


def _lines(geometry: dict[str, Any]) -> list[list[list[float]]]:
    kind, coordinates = geometry.get("type"), geometry.get("coordinates")
    if kind not in ("LineString", "MultiLineString") or not isinstance(coordinates, list):
        raise refusal(f"a road is a LineString or MultiLineString, not {kind!s:.30}")
    lines = [coordinates] if kind == "LineString" else coordinates
    if len(lines) > PIECES_LIMIT_COUNT:
        raise refusal(f"{len(lines)} lines; at most {PIECES_LIMIT_COUNT} are joined")
    return [_positions(line) for line in lines]


def _positions(line: Any) -> list[list[float]]:
    if not isinstance(line, list) or not 1 <= len(line) <= POINTS_LIMIT_COUNT:
        raise refusal(f"a line is a list of 2 to {POINTS_LIMIT_COUNT} positions")
    for i, position in enumerate(line):
        if not isinstance(position, list) or not 2 <= len(position) <= 4:
            raise refusal(f"position {i + 1} is not a list of two or three numbers")
        for value in position:
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
                raise refusal(f"position {i + 1} holds {value!s:.30}, not a number of this world")
    return [[float(v) for v in position[:3]] for position in line]
