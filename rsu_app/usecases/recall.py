"""What the unit remembers of recent passages, to answer a repetition without asking the disk."""

from __future__ import annotations

import hashlib
import struct
from collections import OrderedDict
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadgrip.reasons import Reason
from roadgrip.records import Accepted, Outcome, Passage, Rejected
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
    parts = (
        # A text decoded from JSON may hold half a surrogate pair, which has no UTF-8.
        passage.section_id.encode(errors="surrogatepass"),
        passage.map_version.encode(errors="surrogatepass"),
        summary.table_digest.encode(errors="surrogatepass"),
        struct.pack("<d", summary.duration_s),
        b"%d" % summary.quality,
        values_digest,
    )
    framed = b"".join([part for text in parts for part in (len(text).to_bytes(4, "little"), text)])
    return Marks(hashlib.sha256(framed).digest()[:DIGEST_BYTES], values_digest)


def outcome_of_repetition(known: StoredEstimate, *, passage_id: bytes, content: bytes) -> Outcome:
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
    """The latest stored estimates by id and by values, the oldest forgotten first.

    The store recognises repetitions for as long as it keeps passages; this memory spares it the question and keeps
    answering while the disk does not.

    Args:
        capacity_count: Estimates that are remembered.
    """

    def __init__(self, *, capacity_count: int) -> None:
        self._capacity_count = capacity_count
        self._by_id: OrderedDict[bytes, StoredEstimate] = OrderedDict()
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
        self._by_id[estimate.passage_id] = estimate
        self._id_by_values[estimate.values_digest] = estimate.passage_id
        if earlier:
            self._by_id.move_to_end(estimate.passage_id, last=False)
        while len(self._by_id) > self._capacity_count:
            _, oldest = self._by_id.popitem(last=False)
            self._id_by_values.pop(oldest.values_digest, None)

    def find(self, *, passage_id: bytes, values: bytes) -> StoredEstimate | None:
        """Return what is remembered under the id or, failing that, with the same values."""
        return self._by_id.get(passage_id) or self._by_id.get(self._id_by_values.get(values, b""))
