"""The message MAP: a road section in some hundred bytes, rebuilt to the last bit.

A section's numbers are whole steps already (`roadgrip.section`): nodes are sent as the first one and the 16-bit
millimetre steps between neighbours. The receiver builds the section with the code that built it at the unit and
computes its version anew; the version that is sent along must be the same.
"""

from __future__ import annotations

import cbor2
import numpy as np
from numpy.typing import NDArray

from roadgrip.cbor import TAG_INT16_LE, TAG_INT32_LE
from roadgrip.errors import SectionError, WireError
from roadgrip.protocol import BANK_ORIGIN_CODES, DIRECTION_CODES
from roadgrip.reasons import Reason
from roadgrip.records import MapOffer
from roadgrip.section import LENGTH_LIMITS_M, NODES_LIMIT_COUNT, GnssAnchor, RoadSection, build_section
from roadgrip.wire_fields import (
    DIGEST_BYTES,
    UINT16_MAX,
    Fields,
    check_keys,
    checked_int,
    checked_section_id,
    digest_bytes,
    digest_in,
    int_in,
    meaning_of,
    meanings,
    quanta,
    text_in,
    typed_array_in,
)

TEXT_LIMIT_CHARS = 80
TABLE_DIGESTS_LIMIT_COUNT = 8
ANCHORS_LIMIT_COUNT = 256
_ORIGIN_LIMIT_MM = 10**11
_NODE_LIMIT_MM = 2**31 - 1
_LAT_LIMIT, _LON_LIMIT = 90 * 10**7, 180 * 10**7

_SECTION_ID, _VERSION, _TABLES, _NAME, _DIRECTION, _CRS, _ORIGIN, _FIRST_NODE, _STEPS = range(9)
_SLOPES, _BANK_ORIGIN, _SPEED_LIMIT, _BANK_CAP, _ANCHORS = range(9, 14)
_OPTIONAL = frozenset({_SLOPES, _ANCHORS})
_REQUIRED = frozenset(range(14)) - _OPTIONAL

_DIRECTIONS = meanings(DIRECTION_CODES)
_BANK_ORIGINS = meanings(BANK_ORIGIN_CODES)


def map_to_fields(offer: MapOffer) -> Fields:
    """Return the map of a MAP message.

    Raises:
        WireError: The section has a number or text without a spelling on the air.
    """
    section = offer.section
    if not 0 < len(offer.table_digests) <= TABLE_DIGESTS_LIMIT_COUNT:
        raise WireError(Reason.OUT_OF_RANGE, f"{len(offer.table_digests)} feature tables in one map")
    if max(len(section.name), len(section.crs)) > TEXT_LIMIT_CHARS:
        raise WireError(Reason.MALFORMED, f"name and reference have at most {TEXT_LIMIT_CHARS} characters")
    nodes_mm = section.nodes_mm
    fields: Fields = {
        _SECTION_ID: checked_section_id(section.section_id),
        _VERSION: digest_bytes(section.version, name="the map version"),
        _TABLES: [digest_bytes(digest, name="the feature table") for digest in offer.table_digests],
        _NAME: section.name,
        _DIRECTION: DIRECTION_CODES[section.direction],
        _CRS: section.crs,
        _ORIGIN: [
            quanta(c, per_unit=1000, name="the origin", low=-_ORIGIN_LIMIT_MM, high=_ORIGIN_LIMIT_MM)
            for c in section.origin_m
        ],
        _FIRST_NODE: [
            checked_int(int(c), name="the first node", low=-_NODE_LIMIT_MM, high=_NODE_LIMIT_MM) for c in nodes_mm[0]
        ],
        _STEPS: _int16_array(np.diff(nodes_mm, axis=0), name="a step between nodes"),
        _BANK_ORIGIN: BANK_ORIGIN_CODES[section.bank_origin],
        _SPEED_LIMIT: quanta(section.speed_limit_mps, per_unit=100, name="the speed limit", high=UINT16_MAX),
        _BANK_CAP: quanta(section.bank_cap_ratio, per_unit=10_000, name="the bank cap", high=UINT16_MAX),
    }
    slopes = section.cross_slope_quanta
    if slopes.any():
        fields[_SLOPES] = _int16_array(slopes, name="a cross slope")
    if section.anchors:
        fields[_ANCHORS] = _anchor_array(section)
    return fields


def map_from_fields(value: object) -> MapOffer:
    """Return the map that a MAP message holds.

    Raises:
        WireError: MALFORMED, also when the section is not of the version that came with it.
            OUT_OF_RANGE; no road is like that.
    """
    fields = check_keys(value, required=_REQUIRED, optional=_OPTIONAL)
    version = digest_in(fields, _VERSION, name="the map version")
    steps = np.frombuffer(typed_array_in(fields, _STEPS, tag=TAG_INT16_LE, item_bytes=6, name="the nodes"), "<i2")
    count = len(steps) // 3 + 1
    if count > NODES_LIMIT_COUNT:
        raise WireError(Reason.OUT_OF_RANGE, f"{count} nodes")
    # The line is no shorter than its chords; a profile of more would cost a tenth of a second.
    if np.hypot(steps[0::3], steps[1::3], dtype=np.float64).sum() / 1000.0 > LENGTH_LIMITS_M[1]:
        raise WireError(Reason.OUT_OF_RANGE, f"a section longer than {LENGTH_LIMITS_M[1]:.0f} m")
    first = _numbers_in(fields, _FIRST_NODE, name="the first node", limit=_NODE_LIMIT_MM)
    nodes_mm = np.cumsum(np.vstack([first, steps.reshape(-1, 3).astype(np.int64)]), axis=0)
    slopes = np.zeros(count)
    if _SLOPES in fields:
        raw = np.frombuffer(typed_array_in(fields, _SLOPES, tag=TAG_INT16_LE, item_bytes=2, name="slopes"), "<i2")
        if len(raw) != count or not raw.any():
            raise WireError(Reason.MALFORMED, f"{len(raw)} cross slopes for {count} nodes, or all zero")
        slopes = raw / 10_000.0
    origin_mm = _numbers_in(fields, _ORIGIN, name="the origin", limit=_ORIGIN_LIMIT_MM)
    try:
        section = build_section(
            section_id=checked_section_id(fields[_SECTION_ID]),
            name=text_in(fields, _NAME, limit_chars=TEXT_LIMIT_CHARS, name="the name"),
            nodes_m=nodes_mm / 1000.0,
            speed_limit_mps=int_in(fields, _SPEED_LIMIT, name="the speed limit", high=UINT16_MAX) / 100.0,
            cross_slope_ratio=slopes,
            bank_origin=meaning_of(fields[_BANK_ORIGIN], _BANK_ORIGINS, name="origin of the bank"),
            direction=meaning_of(fields[_DIRECTION], _DIRECTIONS, name="direction"),
            crs=text_in(fields, _CRS, limit_chars=TEXT_LIMIT_CHARS, name="the reference"),
            origin_m=(origin_mm[0] / 1000.0, origin_mm[1] / 1000.0, origin_mm[2] / 1000.0),
            bank_cap_ratio=int_in(fields, _BANK_CAP, name="the bank cap", high=UINT16_MAX) / 10_000.0,
            anchors=_anchors_in(fields) if _ANCHORS in fields else (),
        )
    except SectionError as error:
        raise WireError(Reason.OUT_OF_RANGE, str(error)) from error
    if section.version != version:
        raise WireError(Reason.MALFORMED, f"the map says it is {version} and is {section.version}")
    return MapOffer(section=section, table_digests=_tables_in(fields))


def _int16_array(values: NDArray[np.int64], *, name: str) -> cbor2.CBORTag:
    if np.abs(values).max() > np.iinfo(np.int16).max:
        raise WireError(Reason.OUT_OF_RANGE, f"{name} of {np.abs(values).max()} steps has no place in 16 bits")
    return cbor2.CBORTag(TAG_INT16_LE, values.astype("<i2").tobytes())


def _numbers_in(fields: Fields, key: int, *, name: str, limit: int) -> list[int]:
    value = fields[key]
    if type(value) is not list or len(value) != 3:
        raise WireError(Reason.MALFORMED, f"{name} is not three numbers")
    return [checked_int(v, name=name, low=-limit, high=limit) for v in value]


def _tables_in(fields: Fields) -> tuple[str, ...]:
    value = fields[_TABLES]
    if (
        type(value) is not list
        or not 0 < len(value) <= TABLE_DIGESTS_LIMIT_COUNT
        or any(type(v) is not bytes or len(v) != DIGEST_BYTES for v in value)
    ):
        raise WireError(Reason.MALFORMED, "the feature tables are not one to eight digests")
    return tuple(v.hex() for v in value)


def _anchor_array(section: RoadSection) -> cbor2.CBORTag:
    if len(section.anchors) > ANCHORS_LIMIT_COUNT:
        raise WireError(Reason.OUT_OF_RANGE, f"{len(section.anchors)} anchors; {ANCHORS_LIMIT_COUNT} are possible")
    rows = [
        (
            quanta(a.station_m, per_unit=10, name="an anchor's station", high=_NODE_LIMIT_MM),
            quanta(a.lat_deg, per_unit=10**7, name="a latitude", low=-_LAT_LIMIT, high=_LAT_LIMIT),
            quanta(a.lon_deg, per_unit=10**7, name="a longitude", low=-_LON_LIMIT, high=_LON_LIMIT),
        )
        for a in section.anchors
    ]
    return cbor2.CBORTag(TAG_INT32_LE, np.array(rows, dtype="<i4").tobytes())


def _anchors_in(fields: Fields) -> list[GnssAnchor]:
    raw = typed_array_in(fields, _ANCHORS, tag=TAG_INT32_LE, item_bytes=12, name="the anchors")
    rows = np.frombuffer(raw, "<i4").reshape(-1, 3).tolist()
    if not 0 < len(rows) <= ANCHORS_LIMIT_COUNT:
        raise WireError(Reason.OUT_OF_RANGE, f"{len(rows)} anchors")
    for station, lat, lon in rows:
        if station < 0 or abs(lat) > _LAT_LIMIT or abs(lon) > _LON_LIMIT:
            raise WireError(Reason.OUT_OF_RANGE, "an anchor that is nowhere on earth")
    return [GnssAnchor(station / 10.0, lat / 1e7, lon / 1e7) for station, lat, lon in rows]
