"""Text <-> section: the JSON form in which maps are kept in files and fetched over HTTP.

The text is for people too: SI names with units, one node and one anchor per line. Reading is strict, since a
misspelt key that is silently ignored would be a wrong map. `version` may be left out by whoever writes a section by
hand; when it is there it must fit, so that a map damaged on its way is noticed.
"""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

from roadgrip.errors import SectionError
from roadgrip.section import (
    ANCHORS_LIMIT_COUNT,
    NODES_LIMIT_COUNT,
    BankOrigin,
    Direction,
    GnssAnchor,
    RoadSection,
    build_section,
)

FORMAT = "roadgrip-section"
FORMAT_VERSION = 1
TEXT_LIMIT_CHARS = 1_000_000
"""A thousand nodes take 100,000 characters; whatever is ten times longer is no section."""

_KEYS = frozenset(
    {
        "format",
        "format_version",
        "section_id",
        "name",
        "direction",
        "crs",
        "origin",
        "speed_limit_mps",
        "bank_cap_ratio",
        "bank_origin",
        "anchors",
        "nodes",
    }
)
_ORIGIN_KEYS = ("east_m", "north_m", "height_m")
_ANCHOR_KEYS = ("station_m", "lat_deg", "lon_deg")
_NODE_KEYS = ("x_m", "y_m", "z_m", "cross_slope_ratio")


def section_to_json(section: RoadSection) -> str:
    """Return the section as JSON text that `section_from_json` reads back to an equal section."""
    east, north, height = section.origin_m
    head = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "version": section.version,
        "section_id": section.section_id,
        "name": section.name,
        "direction": section.direction.value,
        "crs": section.crs,
        "origin": {"east_m": east, "north_m": north, "height_m": height},
        "speed_limit_mps": section.speed_limit_mps,
        "bank_cap_ratio": section.bank_cap_ratio,
        "bank_origin": section.bank_origin.value,
    }
    anchors = [
        json.dumps({"station_m": a.station_m, "lat_deg": a.lat_deg, "lon_deg": a.lon_deg}) for a in section.anchors
    ]
    nodes = [
        json.dumps({"x_m": x / 1000, "y_m": y / 1000, "z_m": z / 1000, "cross_slope_ratio": slope / 10_000})
        for (x, y, z), slope in zip(section.nodes_mm.tolist(), section.cross_slope_quanta.tolist(), strict=True)
    ]
    lines = [f" {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}," for key, value in head.items()]
    return "\n".join(["{", *lines, _array("anchors", anchors) + ",", _array("nodes", nodes), "}"]) + "\n"


def section_from_json(text: str) -> RoadSection:
    """Return the section that a JSON text holds.

    Raises:
        SectionError: The text is no section, or one that cannot be; the message names the place.
    """
    if len(text) > TEXT_LIMIT_CHARS:
        _refuse("the text", f"is longer than {TEXT_LIMIT_CHARS} characters")
    try:
        raw = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_twins)
    except (ValueError, RecursionError) as error:
        message = f"section file: not JSON: {error}"
        raise SectionError(message) from error
    top = _object(raw, "the file", _KEYS, optional=frozenset({"version"}))
    if top["format"] != FORMAT or top["format_version"] != FORMAT_VERSION:
        found = f"{top['format']!s:.30} {top['format_version']!s:.10}"
        _refuse("format", f"is {found}, this software reads {FORMAT} {FORMAT_VERSION}")
    origin = _numbers(top["origin"], "origin", _ORIGIN_KEYS)
    anchors = [
        GnssAnchor(*_numbers(a, f"anchors[{i}]", _ANCHOR_KEYS))
        for i, a in enumerate(_list(top["anchors"], "anchors", ANCHORS_LIMIT_COUNT))
    ]
    nodes = [
        _numbers(n, f"nodes[{i}]", _NODE_KEYS) for i, n in enumerate(_list(top["nodes"], "nodes", NODES_LIMIT_COUNT))
    ]
    section = build_section(
        section_id=_text(top["section_id"], "section_id"),
        name=_text(top["name"], "name"),
        nodes_m=[n[:3] for n in nodes],
        speed_limit_mps=_number(top["speed_limit_mps"], "speed_limit_mps"),
        cross_slope_ratio=[n[3] for n in nodes],
        bank_origin=BankOrigin(_choice(top["bank_origin"], "bank_origin", [o.value for o in BankOrigin])),
        direction=Direction(_choice(top["direction"], "direction", [d.value for d in Direction])),
        crs=_text(top["crs"], "crs"),
        origin_m=(origin[0], origin[1], origin[2]),
        bank_cap_ratio=_number(top["bank_cap_ratio"], "bank_cap_ratio"),
        anchors=anchors,
    )
    if top.get("version", section.version) != section.version:
        told = f"{top['version']!s:.20}"
        _refuse("version", f"is {told} but the map is {section.version}; delete the line if you edited the map")
    return section


def _array(key: str, rows: list[str]) -> str:
    return f' "{key}": [' + ",".join(f"\n  {row}" for row in rows) + ("\n ]" if rows else "]")


def _refuse(place: str, problem: str) -> NoReturn:
    message = f"section file: {place} {problem}"
    raise SectionError(message)


def _no_constant(name: str) -> NoReturn:
    _refuse("a number", f"is {name}")


def _no_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        _refuse("an object", f"holds a key twice: {[key for key, _ in pairs]!s:.80}")
    return found


def _object(value: Any, place: str, keys: frozenset[str], *, optional: frozenset[str] = frozenset()) -> dict[str, Any]:
    if not isinstance(value, dict):
        _refuse(place, "is not an object")
    if missing := sorted(keys - set(value)):
        _refuse(place, f"lacks {', '.join(missing)}")
    if unknown := sorted(set(value) - keys - optional):
        _refuse(place, f"holds unknown {', '.join(unknown)!s:.80}")
    return value


def _list(value: Any, place: str, limit: int) -> list[Any]:
    if not isinstance(value, list):
        _refuse(place, "is not a list")
    if len(value) > limit:
        _refuse(place, f"holds {len(value)} entries; at most {limit} are possible")
    return value


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        _refuse(place, "is not a number")
    # 1e999 is valid JSON and becomes infinite; an integer may be too large for any float.
    if not abs(value) <= 1e15 or not math.isfinite(value):
        _refuse(place, "is not a number of this world")
    return float(value)


def _numbers(value: Any, place: str, keys: tuple[str, ...]) -> list[float]:
    found = _object(value, place, frozenset(keys))
    return [_number(found[key], f"{place}.{key}") for key in keys]


def _text(value: Any, place: str) -> str:
    if not isinstance(value, str):
        _refuse(place, "is not a text")
    return value


def _choice(value: Any, place: str, choices: list[str]) -> str:
    if value not in choices:
        _refuse(place, f"is {value!r:.30}, not one of {', '.join(choices)}")
    return str(value)
