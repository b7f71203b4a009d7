"""CSV tables with one point per row; the header says what the columns are.

Position, one of: `east_utm33,north_utm33` (any zone), `east_m,north_m`, `x_m,y_m`, `lat_deg,lon_deg`.
Height, optional: `height`, `height_m` or `z_m`.
Bank, optional: `cross_slope_ratio` (rise towards the left edge) or `bank_ratio` (inward positive).
Speed limit, optional: `speed_limit_kmh`, where 0 means unknown. Other columns are ignored.
"""

from __future__ import annotations

import csv
import math
import re

from roadgrip.survey import POINTS_LIMIT_COUNT, SurveyLine, refusal, survey_line

HEIGHT_COLUMNS = ("height", "height_m", "z_m")
_FIELD_LIMIT_CHARS = 200


def survey_of_csv(text: str, *, crs: str | None = None) -> SurveyLine:
    """Return the line of a table; commas, semicolons or tabs separate, a point is the decimal sign.

    Args:
        text: With a header.
        crs: Coordinate reference; it wins over the one the header tells.

    Raises:
        SectionError: A column is missing or a field is no number; the message names row and column.
    """
    head, _, _ = text.lstrip("\ufeff\r\n ").partition("\n")
    delimiter = max(",;\t", key=head.count)
    try:
        rows = csv.reader(text.lstrip("\ufeff\r\n ").splitlines(), delimiter=delimiter, strict=True)
        header = [name.strip().lower() for name in next(rows, [])]
        table = [(rows.line_num, row) for row in rows if any(field.strip() for field in row)]
    except csv.Error as error:
        raise refusal(f"not a CSV table: {error}") from error
    if len(table) > POINTS_LIMIT_COUNT:
        raise refusal(f"{len(table)} rows; at most {POINTS_LIMIT_COUNT} are read")
    if len(set(header)) != len(header):
        raise refusal("two columns have the same name")
    first, second, crs = _position_columns(header, crs)
    height = next((name for name in HEIGHT_COLUMNS if name in header), None)
    slope = "cross_slope_ratio" if "cross_slope_ratio" in header else None
    bank = "bank_ratio" if "bank_ratio" in header else None
    if slope and bank:
        raise refusal("the table holds cross_slope_ratio and bank_ratio; leave one out")
    wanted = [first, second, *([height] if height else [])]

    def column(name: str) -> list[float]:
        at = header.index(name)
        return [_number(row, at, line=line, name=name) for line, row in table]

    columns = [column(name) for name in wanted]
    return survey_line(
        [list(point) for point in zip(*columns, strict=True)],
        crs=crs,
        cross_slope_ratio=column(slope) if slope else None,
        bank_ratio=column(bank) if bank else None,
        speed_limits_kph=column("speed_limit_kmh") if "speed_limit_kmh" in header else (),
    )


def _position_columns(header: list[str], crs: str | None) -> tuple[str, str, str]:
    for name in header:
        match = re.fullmatch(r"east_utm(\d{1,2})", name, re.ASCII)
        if match and f"north_utm{match[1]}" in header:
            zone = int(match[1])
            # ETRS 89 covers Europe's zones only; elsewhere UTM means WGS 84.
            told = f"EPSG:{25800 + zone}" if 28 <= zone <= 38 else f"EPSG:{32600 + zone}"
            return name, f"north_utm{match[1]}", crs or told
    if {"lat_deg", "lon_deg"} <= set(header):
        return "lon_deg", "lat_deg", crs or "EPSG:4326"
    if {"east_m", "north_m"} <= set(header):
        if crs is None:
            raise refusal("east_m and north_m do not say of which reference; give --crs EPSG:25833 or the like")
        return "east_m", "north_m", crs
    if {"x_m", "y_m"} <= set(header):
        return "x_m", "y_m", crs or "local"
    raise refusal(
        f"no position among the columns {', '.join(header)[:80]}; needed are east_utm33,north_utm33 or east_m,north_m "
        "or x_m,y_m or lat_deg,lon_deg"
    )


def _number(row: list[str], at: int, *, line: int, name: str) -> float:
    field = row[at].strip() if at < len(row) else ""
    try:
        value = float(field) if len(field) <= _FIELD_LIMIT_CHARS else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise refusal(f"line {line}, column {name}: {field[:30]!r} is not a number")
    return value
