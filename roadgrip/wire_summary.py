"""The message SUMMARY: bytes to a passage and back, the general way and a short one.

Most of what a unit is sent are summaries, and a deterministic encoding has but one spelling for each. So a summary can
be read by comparing it with that spelling, in a third of the time that it takes to decode it, to encode it again for
comparison, and to look at every field. Whatever is not spelled so goes the general way, which says what is wrong.
"""

from __future__ import annotations

import re
import struct
from functools import lru_cache
from math import isfinite

import cbor2

from roadgrip.cbor import TAG_FLOAT32_LE
from roadgrip.errors import WireError
from roadgrip.features import TABLES
from roadgrip.reasons import Reason
from roadgrip.records import PASSAGE_ID_BYTES, KinematicSummary, Passage, QualityFlag
from roadgrip.wire_fields import (
    Fields,
    bytes_in,
    check_keys,
    checked_int,
    checked_passage_id,
    checked_section_id,
    digest_bytes,
    digest_in,
    int_in,
    quanta,
    typed_array_in,
)

SUMMARY_VALUES_LIMIT_COUNT = 224
"""More than any feature table to come has, and as many as fit one frame with a signature; the table's digest says how
many there must be."""

_ALL_QUALITY = sum(QualityFlag)
_QUALITIES = tuple(map(QualityFlag, range(_ALL_QUALITY + 1)))
_SUMMARY_KEYS = frozenset(range(8))


@lru_cache(maxsize=8)
def _floats(count: int) -> struct.Struct:
    return struct.Struct(f"<{count}f")


def _check_finite(values: tuple[float, ...]) -> None:
    # The sum of finite 32-bit floats is finite in 64 bits, and that of others never is.
    if not isfinite(sum(values)):
        raise WireError(Reason.NOT_FINITE, "a statistic is not finite")


def _check_count(count: int, *, table_digest: str) -> None:
    # Of a table not spoken here nobody knows the length; who knows which tables are served refuses it by its digest.
    table = TABLES.get(table_digest)
    if (table is not None and count != len(table.kinematic)) or not 0 < count <= SUMMARY_VALUES_LIMIT_COUNT:
        raise WireError(Reason.MALFORMED, f"{count} statistics for feature table {table_digest}")


def summary_to_fields(passage: Passage) -> Fields:
    """Return the map that a SUMMARY is.

    Raises:
        WireError: The passage holds what has no spelling on the air.
    """
    summary = passage.summary
    _check_count(len(summary.values), table_digest=summary.table_digest)
    _check_finite(summary.values)
    try:
        values = _floats(len(summary.values)).pack(*summary.values)
    except OverflowError as error:
        raise WireError(Reason.NOT_FINITE, "a statistic is not finite in 32 bits") from error
    return {
        0: checked_passage_id(passage.passage_id),
        1: checked_section_id(passage.section_id),
        2: digest_bytes(passage.map_version, name="the map version"),
        3: digest_bytes(summary.table_digest, name="the feature table"),
        4: cbor2.CBORTag(TAG_FLOAT32_LE, values),
        5: quanta(summary.duration_s, per_unit=100, name="the duration", reason=Reason.IMPOSSIBLE_DURATION),
        6: checked_int(int(summary.quality), name="the quality", low=0, high=_ALL_QUALITY),
        7: quanta(passage.age_s, per_unit=100, name="the age", reason=Reason.IMPOSSIBLE_AGE),
    }


def summary_from_fields(value: object) -> Passage:
    """Return the passage that the map of a SUMMARY holds.

    Raises:
        WireError: As `roadgrip.wire.open_message`.
    """
    fields = check_keys(value, required=_SUMMARY_KEYS)
    table_digest = digest_in(fields, 3, name="the feature table")
    raw = typed_array_in(fields, 4, tag=TAG_FLOAT32_LE, item_bytes=4, name="the statistics")
    _check_count(len(raw) // 4, table_digest=table_digest)
    values = _floats(len(raw) // 4).unpack(raw)
    _check_finite(values)
    return Passage(
        passage_id=bytes_in(fields, 0, size=PASSAGE_ID_BYTES, name="the passage id"),
        section_id=checked_section_id(fields[1]),
        map_version=digest_in(fields, 2, name="the map version"),
        summary=KinematicSummary(
            values=values,
            table_digest=table_digest,
            duration_s=int_in(fields, 5, name="the duration", reason=Reason.IMPOSSIBLE_DURATION) / 100,
            quality=_QUALITIES[int_in(fields, 6, name="the quality", high=_ALL_QUALITY)],
        ),
        age_s=int_in(fields, 7, name="the age", reason=Reason.IMPOSSIBLE_AGE) / 100,
    )


# Eight keys in order. Lengths and numbers in their shortest spelling, as RFC 8949, section 4.2.1, demands.
_BEFORE_VALUES = re.compile(
    rb"\xa8"
    rb"\x00\x50(?P<passage_id>.{16})"
    rb"\x01(?P<section_head>[\x61-\x77]|\x78[\x18-\x30])(?P<section_id>[a-z0-9-]{1,48})"
    rb"\x02\x48(?P<map_version>.{8})"
    rb"\x03\x48(?P<table_digest>.{8})"
    rb"\x04\xd8\x55(?:\x58(?P<short_length>[\x18-\xff])|\x59(?P<long_length>[\x01-\xff].))",
    re.DOTALL,
)
_NUMBER = rb"([\x00-\x17]|\x18[\x18-\xff]|\x19[\x01-\xff].|\x1a(?:[\x01-\xff].|\x00[\x01-\xff])..)"
_BEHIND_VALUES = re.compile(rb"\x05%b\x06%b\x07%b" % (_NUMBER, _NUMBER, _NUMBER), re.DOTALL)


def summary_at_once(content: bytes) -> Passage | None:
    """Return the passage that a SUMMARY holds if it is a faultless one; None leaves it to `summary_from_fields`.

    Args:
        content: The deterministic encoding, without a signature.
    """
    before = _BEFORE_VALUES.match(content)
    if before is None:
        return None
    passage_id, section_head, section_id, map_version, table, short_length, long_length = before.groups()
    values_at = before.end()
    length_bytes = short_length[0] if short_length else int.from_bytes(long_length, "big")
    behind = _BEHIND_VALUES.fullmatch(content, values_at + length_bytes)
    if behind is None or length_bytes % 4 or section_head[-1] - (len(section_head) == 1) * 0x60 != len(section_id):
        return None
    table_digest, known_count = _table_of(table)
    count = length_bytes // 4
    values = _floats(count).unpack_from(content, values_at)
    duration, quality, age = map(_number, behind.groups())
    if count != (known_count or count) or not 0 < count <= SUMMARY_VALUES_LIMIT_COUNT or quality > _ALL_QUALITY:
        return None
    if not isfinite(sum(values)):
        return None
    summary = KinematicSummary(values, table_digest, duration / 100, _QUALITIES[quality])
    return Passage(passage_id, section_id.decode("ascii"), map_version.hex(), summary, age / 100)


@lru_cache(maxsize=64)
def _table_of(digest: bytes) -> tuple[str, int | None]:
    """Return a feature table's digest as records hold it, and how many statistics it has; None: nobody knows."""
    table = TABLES.get(digest.hex())
    return digest.hex(), None if table is None else len(table.kinematic)


def _number(spelled: bytes) -> int:
    return spelled[0] if len(spelled) == 1 else int.from_bytes(spelled[1:], "big")
