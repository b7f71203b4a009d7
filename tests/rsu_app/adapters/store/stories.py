"""What the store's tests start from."""

from __future__ import annotations

from roadgrip.records import NotCounted, Passage
from rsu_app.domain.plausibility import summary_values
from rsu_app.ports import PassageEntry, StoredEstimate
from rsu_app.usecases.recall import marks_of
from tests.rsu_app.fakes import NOON_UNIX_S, make_passage, make_section

SECTION = make_section()


def make_entry(
    seed: int = 0,
    *,
    received_unix_s: float = NOON_UNIX_S,
    mu: float | None = 0.5,
    flags: NotCounted = NotCounted.NONE,
    passage: Passage | None = None,
) -> PassageEntry:
    passage = passage or make_passage(SECTION, seed=seed)
    values = summary_values(passage.summary)
    marks = marks_of(passage, values)
    return PassageEntry(
        passage=passage,
        values=values,
        received_unix_s=received_unix_s,
        estimate=StoredEstimate(
            passage_id=passage.passage_id,
            section_id=passage.section_id,
            content_digest=marks.content_digest,
            values_digest=marks.values_digest,
            mu=mu,
            flags=flags,
            left_unix_s=received_unix_s - passage.age_s,
            bundle_id="0123456789abcdef",
        ),
    )
