"""The answer of the Norwegian road register NVDB, API version 3 or 4, to a query for segmented road links.

https://nvdbapiles-v3.atlas.vegvesen.no/vegnett/veglenkesekvenser/segmentert?vegsystemreferanse=FV27S1D1m0-600
"""

from __future__ import annotations

from typing import Any

from roadgrip.survey import PIECES_LIMIT_COUNT, SurveyLine, joined, refusal
from rsu_app.road_import.wkt import survey_of_wkt

_UTM33_WITH_HEIGHTS = "EPSG:5973"


def looks_like_nvdb(raw: object) -> bool:
    """Return whether decoded JSON has the shape of an NVDB answer."""
    return isinstance(raw, dict) and "objekter" in raw


def survey_of_nvdb(raw: Any, *, crs: str | None = None) -> SurveyLine:
    """Return the line that the segments of an answer make when joined.

    Segments that have ended (`sluttdato`) are history and left out. The answer holds no speed limits.

    Args:
        raw: The decoded JSON.
        crs: Coordinate reference; left out, the one each segment names, or UTM 33 with heights.

    Raises:
        SectionError: It is no such answer, or its segments do not form one line.
    """
    objects = raw.get("objekter") if isinstance(raw, dict) else None
    if not isinstance(objects, list):
        raise refusal("an NVDB answer holds a list `objekter`")
    if len(objects) > PIECES_LIMIT_COUNT:
        raise refusal(f"{len(objects)} segments; at most {PIECES_LIMIT_COUNT} are joined: narrow the query")
    pieces = []
    for i, segment in enumerate(objects):
        if not isinstance(segment, dict):
            raise refusal(f"objekter[{i}] is not an object")
        if _has_ended(segment):
            continue
        geometry = segment.get("geometri")
        text = geometry.get("wkt") if isinstance(geometry, dict) else None
        if not isinstance(geometry, dict) or not isinstance(text, str):
            raise refusal(f"objekter[{i}] has no geometri.wkt")
        srid = geometry.get("srid")
        known = f"EPSG:{srid!s:.8}" if srid is not None else None
        pieces.append(survey_of_wkt(text, crs=crs or known or _UTM33_WITH_HEIGHTS))
    if not pieces:
        raise refusal("the NVDB answer holds no live segment")
    return joined(pieces)


def _has_ended(segment: dict[str, Any]) -> bool:
    metadata = segment.get("metadata")
    return bool(segment.get("sluttdato") or (isinstance(metadata, dict) and metadata.get("sluttdato")))
