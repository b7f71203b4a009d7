"""One encoding for each value: the strict dialect of CBOR that goes over the air.

Deterministic CBOR (RFC 8949, section 4.2) without floats, simple values or tags, except that numeric arrays are byte
strings under the tags of RFC 8746 and a signed message carries the tag of COSE_Sign1. What decodes here encodes to
the same bytes again, so a message has one digest, and there is no second spelling to smuggle something in.
"""

from __future__ import annotations

from typing import Any, NoReturn, cast

import cbor2

from roadgrip.errors import WireError
from roadgrip.reasons import Reason

TAG_SIGN1 = 18
"""COSE_Sign1 (RFC 9052)."""
TAG_INT16_LE = 77
"""Typed arrays of RFC 8746: signed 16-bit, signed 32-bit and 32-bit floating point numbers, little-endian."""
TAG_INT32_LE = 78
TAG_FLOAT32_LE = 85

DEPTH_LIMIT = 4
"""The deepest message is a signed one: tag, array, map of the protected header; a map holds arrays of numbers."""

# Everything that cbor2 would turn into an object of its own: dates, big numbers, regular expressions, references...
_BUILT_IN_TAGS = (0, 1, 2, 3, 4, 5, 25, 28, 29, 30, 35, 36, 37, 52, 54, 100, 256, 258, 260, 261, 1004, 43000, 55799)
_OUR_TAGS = frozenset({TAG_SIGN1, TAG_INT16_LE, TAG_INT32_LE, TAG_FLOAT32_LE})


def strict_dumps(value: object) -> bytes:
    """Return the deterministic encoding of a value; map keys must be whole numbers as those of our messages.

    For such keys the old canonical order, which cbor2 implements, and that of RFC 8949 are the same; `strict_loads`
    refuses those for which they differ: a negative key beside a larger one that is spelled longer.
    """
    return cbor2.dumps(value, canonical=True)


def strict_loads(data: bytes) -> Any:
    """Return the value that `data` is the deterministic encoding of; typed arrays and COSE_Sign1 as `cbor2.CBORTag`.

    Args:
        data: One data item and nothing behind it. The caller bounds its length.

    Raises:
        WireError: MALFORMED; it is no such encoding.
    """
    try:
        value = cbor2.loads(
            data,
            tag_hook=_our_tag,
            semantic_decoders=_REFUSALS,
            max_depth=DEPTH_LIMIT,
            allow_indefinite=False,
            allow_duplicate_keys=False,
        )
        # The proof of determinism is also that of completeness: a byte behind the item would be missing here. The order
        # of keys is looked at apart, which takes half the time of having them sorted.
        if cbor2.dumps(value) == data and _is_ours(value):
            return value
        problem = "not the deterministic encoding, or bytes behind it"
    except (cbor2.CBORError, ValueError, TypeError, OverflowError, RecursionError, MemoryError) as error:
        problem = str(error)
    raise WireError(Reason.MALFORMED, f"CBOR: {problem[:120]}")


def _is_ours(value: object) -> bool:
    """Return whether a value is made of what messages are made of, and the keys of every map are in order.

    They are whole numbers, ascending, the negative ones at the end and the longer spelled ones behind the shorter: so
    RFC 8949 and the order that it replaced, in which cbor2 writes, agree. Floats and simple values have several
    spellings or no meaning here. What lies within two tags comes as the kind of map and list that cannot be changed.
    """
    kind = type(value)
    if kind in _PLAIN:
        return True
    if kind in _MAPS:
        last, last_size = (False, -1), 0
        for key, inner in cast("dict[object, object]", value).items():
            if type(key) is not int:
                return False
            place, size = (key < 0, abs(key)), 1 if -24 <= key < 24 else len(cbor2.dumps(key))
            if place <= last or size < last_size or not _is_ours(inner):
                return False
            last, last_size = place, size
        return True
    if kind in _LISTS:
        return all(map(_is_ours, cast("list[object]", value)))
    return kind is cbor2.CBORTag and _is_ours(cast("cbor2.CBORTag", value).value)


_PLAIN = frozenset({int, bytes, str})
_MAPS = frozenset({dict, cbor2.frozendict})
_LISTS = frozenset({list, tuple})


def _our_tag(tag: cbor2.CBORTag, immutable: bool) -> cbor2.CBORTag:  # noqa: ARG001, FBT001 - cbor2 calls it so
    if tag.tag not in _OUR_TAGS:
        raise ValueError(f"tag {tag.tag} has no place in a message")
    return tag


def _refused_tag(value: object, immutable: bool) -> NoReturn:  # noqa: ARG001, FBT001 - cbor2 calls it so
    raise ValueError("a tag that has no place in a message")


_REFUSALS = dict.fromkeys(_BUILT_IN_TAGS, _refused_tag)
