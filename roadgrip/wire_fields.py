"""Single fields of a message: numbers in fixed steps, ids, digests, codes, typed arrays; both ways.

What writes refuses what could not be read back, with the same reason: a message that was encoded decodes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite
from typing import Any, TypeAlias, TypeVar

import cbor2

from roadgrip.errors import WireError
from roadgrip.reasons import Reason
from roadgrip.records import PASSAGE_ID_BYTES

Fields: TypeAlias = dict[int, Any]
"""The map that a message is, by key."""

UINT16_MAX = 2**16 - 1
UINT32_MAX = 2**32 - 1
UNIX_LIMIT_S = 2**40
DIGEST_BYTES = 8
_SECTION_ID = re.compile(r"[a-z0-9-]{1,48}")
_INT_ALONE = frozenset({int})

E = TypeVar("E")


def quanta(
    value: float,
    *,
    per_unit: int,
    name: str,
    low: int = 0,
    high: int = UINT32_MAX,
    reason: Reason = Reason.OUT_OF_RANGE,
) -> int:
    """Return a quantity as a whole number of steps, the nearest.

    Args:
        value: The quantity.
        per_unit: Steps in one unit.
        name: What it is, for the message.
        low: Fewest steps that have a spelling.
        high: Most steps.
        reason: What to say of a number without a spelling.

    Raises:
        WireError: NOT_FINITE, or `reason`.
    """
    if not isfinite(value):
        raise WireError(Reason.NOT_FINITE, f"{name} is {value}")
    steps = round(value * per_unit)
    if not low <= steps <= high:
        raise WireError(reason, f"{name} of {value} has no place on the air")
    return steps


def int_in(
    fields: Fields,
    key: int,
    *,
    name: str,
    low: int = 0,
    high: int = UINT32_MAX,
    reason: Reason = Reason.OUT_OF_RANGE,
) -> int:
    """Return the whole number under a key.

    Raises:
        WireError: MALFORMED, it is none (a float, a boolean); or `reason`, it is outside `low` to `high`.
    """
    return checked_int(fields[key], name=name, low=low, high=high, reason=reason)


def checked_int(value: object, *, name: str, low: int, high: int, reason: Reason = Reason.OUT_OF_RANGE) -> int:
    """Return `value` if it is a whole number from `low` to `high`.

    Raises:
        WireError: MALFORMED, it is none (a float, a boolean); or `reason`, it is outside.
    """
    if type(value) is not int:
        raise WireError(Reason.MALFORMED, f"{name} is not a whole number")
    if not low <= value <= high:
        raise WireError(reason, f"{name} of {value} steps")
    return value


def check_keys(fields: object, *, required: frozenset[int], optional: frozenset[int] = frozenset()) -> Fields:
    """Return the map of a message if it has the keys it must have and no others.

    Raises:
        WireError: MALFORMED.
    """
    if type(fields) is not dict:
        raise WireError(Reason.MALFORMED, "a message is a map")
    keys = fields.keys()
    # True, 1.0 and the simple value 1 all equal the key 1, and would be other spellings of the same message.
    if (keys == required or required <= keys <= required | optional) and _INT_ALONE.issuperset(map(type, keys)):
        return fields
    raise WireError(Reason.MALFORMED, f"the message has the keys {sorted(map(repr, keys))[:20]}")


def bytes_in(fields: Fields, key: int, *, size: int, name: str) -> bytes:
    """Return the byte string of exactly `size` bytes under a key.

    Raises:
        WireError: MALFORMED.
    """
    value = fields[key]
    if type(value) is not bytes or len(value) != size:
        raise WireError(Reason.MALFORMED, f"{name} is not {size} bytes")
    return value


def text_in(fields: Fields, key: int, *, limit_chars: int, name: str) -> str:
    """Return the text under a key.

    Raises:
        WireError: MALFORMED; it is no text, or longer than `limit_chars`.
    """
    value = fields[key]
    if type(value) is not str or len(value) > limit_chars:
        raise WireError(Reason.MALFORMED, f"{name} is not a text of at most {limit_chars} characters")
    return value


def checked_passage_id(passage_id: bytes) -> bytes:
    """Return a passage id if it is one.

    Raises:
        WireError: MALFORMED.
    """
    if type(passage_id) is not bytes or len(passage_id) != PASSAGE_ID_BYTES:
        raise WireError(Reason.MALFORMED, f"a passage id is {PASSAGE_ID_BYTES} bytes")
    return passage_id


def checked_section_id(section_id: object) -> str:
    """Return a section id if it is spelt like one.

    Raises:
        WireError: MALFORMED.
    """
    if type(section_id) is str and _SECTION_ID.fullmatch(section_id):
        return section_id
    raise WireError(Reason.MALFORMED, "a section id is 1 to 48 lower-case letters, digits and hyphens")


def digest_bytes(digest: str, *, name: str) -> bytes:
    """Return the eight bytes of a digest that records hold as sixteen hexadecimal characters.

    Raises:
        WireError: MALFORMED; it is no such digest.
    """
    try:
        raw = bytes.fromhex(digest)
    except (ValueError, TypeError):
        raw = b""
    if len(raw) != DIGEST_BYTES or raw.hex() != digest:
        raise WireError(Reason.MALFORMED, f"{name} {digest[:40]!r} is not sixteen hexadecimal characters")
    return raw


def digest_in(fields: Fields, key: int, *, name: str) -> str:
    """Return the digest under a key as sixteen hexadecimal characters.

    Raises:
        WireError: MALFORMED.
    """
    return bytes_in(fields, key, size=DIGEST_BYTES, name=name).hex()


def meanings(codes: Mapping[E, int]) -> dict[int, E]:
    """Return a table of codes read the other way."""
    return {code: meaning for meaning, code in codes.items()}


def meaning_of(code: object, table: Mapping[int, E], *, name: str) -> E:
    """Return what a code means.

    Raises:
        WireError: MALFORMED; no such code in this version.
    """
    if type(code) is int and code in table:
        return table[code]
    raise WireError(Reason.MALFORMED, f"no {name} has the code {str(code)[:20]}")


def typed_array_in(fields: Fields, key: int, *, tag: int, item_bytes: int, name: str) -> bytes:
    """Return the bytes of the typed array under a key.

    Raises:
        WireError: MALFORMED; another tag, no byte string, or a broken item at its end.
    """
    value = fields[key]
    if (
        type(value) is cbor2.CBORTag
        and value.tag == tag
        and type(value.value) is bytes
        and len(value.value) % item_bytes == 0
    ):
        return value.value
    raise WireError(Reason.MALFORMED, f"{name} is not a typed array with tag {tag}")
