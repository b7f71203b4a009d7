"""Well-known text: LINESTRING and MULTILINESTRING, with Z and M, with or without the space before the bracket."""

from __future__ import annotations

import re

from roadgrip.survey import POINTS_LIMIT_COUNT, SurveyLine, joined, refusal, survey_line

_HEAD = re.compile(
    # No two runs of blanks meet: a long one would be shared out between them in every possible way.
    r"(?:SRID\s*=\s*(?P<srid>\d{1,6})\s*;\s*)?(?P<multi>MULTI)?LINESTRING\s*(?:(?P<axes>ZM|Z|M)\s*)?(?P<body>\(.*\))",
    re.IGNORECASE | re.DOTALL | re.ASCII,
)
_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_POINT = re.compile(rf"\s*{_NUMBER}(?:\s+{_NUMBER})+\s*", re.ASCII)
_POINT_LIMIT_CHARS = 400


def survey_of_wkt(text: str, *, crs: str | None = None) -> SurveyLine:
    """Return the line of a well-known text.

    Args:
        text: One geometry; "SRID=25833;" may stand before it.
        crs: Coordinate reference; it wins over the one in the text, and must be given when there is none.

    Raises:
        SectionError: The text is no line, or no coordinate reference is known.
    """
    match = _HEAD.fullmatch(text.strip().removesuffix(";").rstrip())
    if not match:
        raise refusal(f"not a LINESTRING or MULTILINESTRING in well-known text: {text.strip()[:40]!r}")
    if crs is None and match["srid"]:
        crs = f"EPSG:{match['srid']}"
    if crs is None:
        raise refusal("well-known text does not say where it lies; give --crs EPSG:25833 or the like, or --crs local")
    body = match["body"][1:-1]
    axes = (match["axes"] or "").upper()
    if not match["multi"]:
        return survey_line(_points(body, axes), crs=crs)
    parts = re.fullmatch(r"\s*\((.*)\)\s*", body, re.DOTALL)
    if not parts:
        raise refusal("a MULTILINESTRING needs brackets around each of its lines")
    return joined([survey_line(_points(part, axes), crs=crs) for part in re.split(r"\)\s*,\s*\(", parts[1])])


def _points(body: str, axes: str) -> list[list[float]]:
    if body.count(",") >= POINTS_LIMIT_COUNT:
        raise refusal(f"more than {POINTS_LIMIT_COUNT} points")
    points = []
    for i, raw in enumerate(body.split(",")):
        if len(raw) > _POINT_LIMIT_CHARS or not _POINT.fullmatch(raw):
            raise refusal(f"point {i + 1} is {raw.strip()[:40]!r}, not two to four numbers")
        numbers = [float(word) for word in raw.split()]
        expected = {"": {2, 3}, "Z": {3}, "M": {3}, "ZM": {4}}[axes]
        if len(numbers) not in expected:
            raise refusal(f"point {i + 1} has {len(numbers)} numbers, which does not fit LINESTRING {axes}".rstrip())
        # A measure along the road (M) is not a height.
        points.append(numbers[:2] if axes == "M" else numbers[:3])
    return points
