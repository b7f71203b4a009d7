"""What the unit remembers of recent passages, to answer a repetition without asking the disk."""

from __future__ import annotations

import hashlib
import struct
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadgrip.reasons import Reason
from roadgrip.records import Accepted, NotCounted, Outcome, Passage, Rejected
from rsu_app.ports import StoredEstimate

DIGEST_BYTES = 16


@dataclass(frozen=True, slots=True)
class AcceptedAgain(Accepted):
    """The answer to a passage that was accepted before: the same as then. Told apart only to be counted apart."""


class Marks(NamedTuple):
    """What a passage is known again by.

    Attributes:
        content_digest: Of everything the sender says but the age, which grows from attempt to attempt. 16 bytes.
        values_digest: Of the summary's values; two honest passages never share it. 16 bytes.
    """

    content_digest: bytes
    values_digest: bytes


def marks_of(passage: Passage, values: NDArray[np.float32]) -> Marks:
    """Return what a passage is known again by.

    Args:
        passage: What a vehicle claims.
        values: Of its summary, as `rsu_app.domain.plausibility.summary_values` gives them. (k,)
    """
    summary = passage.summary
    values_digest = hashlib.sha256(values.astype("<f4", copy=False).tobytes()).digest()[:DIGEST_BYTES]
    place = _place(passage.section_id, passage.map_version, summary.table_digest)
    content = b"".join(
        (place, _DURATION.pack(8, summary.duration_s), _quality(int(summary.quality)), _DIGEST_LENGTH, values_digest)
    )
    return Marks(hashlib.sha256(content).digest()[:DIGEST_BYTES], values_digest)


# Each part of the content with its length before it. Most parts are those of the passage before.
_DURATION = struct.Struct("<Id")
_DIGEST_LENGTH = DIGEST_BYTES.to_bytes(4, "little")


@lru_cache(maxsize=1024)
def _place(*texts: str) -> bytes:
    # A text decoded from JSON may hold half a surrogate pair, which has no UTF-8.
    return b"".join([_framed(text.encode(errors="surrogatepass")) for text in texts])


@lru_cache(maxsize=1024)
def _quality(quality: int) -> bytes:
    return _framed(b"%d" % quality)


def _framed(part: bytes) -> bytes:
    return len(part).to_bytes(4, "little") + part


class Known(NamedTuple):
    """What suffices to answer a passage that meets a stored one.

    Attributes:
        passage_id: Of the stored one.
        content_digest: As in `Marks`.
        values_digest: As in `Marks`.
        flags: Why it does not count.
    """

    passage_id: bytes
    content_digest: bytes
    values_digest: bytes
    flags: NotCounted


def outcome_of_repetition(known: Known | StoredEstimate, *, passage_id: bytes, content: bytes) -> Outcome:
    """Return the answer to a passage that meets a stored one.

    The same id and content: sent again because a receipt was lost, so the answer is the earlier one. The same id
    with other content, or the same values under another id: refused.
    """
    if known.passage_id != passage_id:
        return Rejected(Reason.REPLAYED, "the same values were sent under another passage id")
    if known.content_digest != content:
        return Rejected(Reason.PASSAGE_ID_REUSED, "this passage id was used for another passage")
    return AcceptedAgain(known.flags)


class Recall:
    """The latest stored passages by id and by values, the oldest forgotten first.

    The store recognises repetitions for as long as it keeps passages; this memory spares it the question and keeps
    answering while the disk does not.

    Args:
        capacity_count: Passages that are remembered, some 400 bytes each.
    """

    def __init__(self, *, capacity_count: int) -> None:
        self._capacity_count = capacity_count
        self._by_id: OrderedDict[bytes, Known] = OrderedDict()
        self._id_by_values: dict[bytes, bytes] = {}

    def __len__(self) -> int:
        return len(self._by_id)

    def __contains__(self, passage_id: object) -> bool:
        return passage_id in self._by_id

    def remember(self, estimate: StoredEstimate, *, earlier: bool = False) -> None:
        """Keep an estimate; the oldest goes if there is no room.

        Args:
            estimate: Of a stored passage.
            earlier: It is older than all that are kept: it takes no other's place.
        """
        if earlier and len(self._by_id) >= self._capacity_count:
            return
        self._by_id[estimate.passage_id] = Known(
            estimate.passage_id, estimate.content_digest, estimate.values_digest, estimate.flags
        )
        self._id_by_values[estimate.values_digest] = estimate.passage_id
        if earlier:
            self._by_id.move_to_end(estimate.passage_id, last=False)
        while len(self._by_id) > self._capacity_count:
            _, oldest = self._by_id.popitem(last=False)
            self._id_by_values.pop(oldest.values_digest, None)

    def find(self, *, passage_id: bytes, values: bytes) -> Known | None:
        """Return what is remembered under the id or, failing that, with the same values."""
        return self._by_id.get(passage_id) or self._by_id.get(self._id_by_values.get(values, b""))
