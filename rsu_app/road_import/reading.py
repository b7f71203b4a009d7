"""Which parser a file wants, and the way through it."""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Any, NoReturn

from roadgrip.survey import SurveyLine, refusal
from rsu_app.road_import.geojson import survey_of_geojson
from rsu_app.road_import.nvdb import looks_like_nvdb, survey_of_nvdb
from rsu_app.road_import.table import survey_of_csv
from rsu_app.road_import.wkt import survey_of_wkt

BYTES_LIMIT = 20_000_000


class RoadFormat(StrEnum):
    """How a road is written down."""

    AUTO = "auto"
    NVDB = "nvdb"
    WKT = "wkt"
    GEOJSON = "geojson"
    CSV = "csv"


def survey_of_bytes(data: bytes, *, road_format: RoadFormat = RoadFormat.AUTO, crs: str | None = None) -> SurveyLine:
    """Return the surveyed line that a file holds.

    Args:
        data: The file, UTF-8.
        road_format: How to read it; `AUTO` looks at the first characters.
        crs: Coordinate reference; it wins over what the file says.

    Raises:
        SectionError: It cannot be read so; the message says why.
    """
    if len(data) > BYTES_LIMIT:
        raise refusal(f"{len(data)} bytes; at most {BYTES_LIMIT} are read")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise refusal(f"not UTF-8 text (byte {error.start}); is it compressed?") from error
    if not text.strip():
        raise refusal("the file is empty")
    if road_format is RoadFormat.AUTO:
        road_format = _guessed(text)
    match road_format:
        case RoadFormat.WKT:
            return survey_of_wkt(text, crs=crs)
        case RoadFormat.CSV:
            return survey_of_csv(text, crs=crs)
        case RoadFormat.NVDB:
            return survey_of_nvdb(_json(text), crs=crs)
        case _:
            raw = _json(text)
            return survey_of_nvdb(raw, crs=crs) if looks_like_nvdb(raw) else survey_of_geojson(raw, crs=crs)


def _guessed(text: str) -> RoadFormat:
    start = text.lstrip()[:40].upper()
    if start.startswith(("{", "[")):
        return RoadFormat.GEOJSON
    if start.startswith(("LINESTRING", "MULTILINESTRING", "SRID")):
        return RoadFormat.WKT
    return RoadFormat.CSV


def _json(text: str) -> Any:
    def no_constant(name: str) -> NoReturn:
        raise refusal(f"{name} is not a number of JSON")

    try:
        return json.loads(text, parse_constant=no_constant)
    except (ValueError, RecursionError) as error:
        raise refusal(f"not JSON: {error}") from error
