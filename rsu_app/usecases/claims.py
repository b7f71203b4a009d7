"""From what vehicles claim to what is stored of it: judged together, as far as one model answers for all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadgrip.errors import BundleError
from roadgrip.reasons import Reason
from roadgrip.records import Passage, Rejected
from rsu_app.domain.judgement import Judgement
from rsu_app.domain.plausibility import age_flag, implausibilities, summary_values, together
from rsu_app.ports import FrictionModel, PassageEntry, StoredEstimate
from rsu_app.usecases.recall import Marks, marks_of
from rsu_app.usecases.section_state import SectionState
from rsu_app.usecases.shadowing import Shadow, answers_of, asked_beside


class Claim(NamedTuple):
    """A passage as it is looked at: its values are turned into an array once.

    Attributes:
        passage: What a vehicle says.
        values: Of its summary, in 32 bits. (k,)
        marks: What it is known again by.
    """

    passage: Passage
    values: NDArray[np.float32]
    marks: Marks


class Judges(NamedTuple):
    """The models that are asked.

    Attributes:
        live: The one that is heard; None: nobody can judge.
        shadow: The one that is compared; None most of the time.
    """

    live: FrictionModel | None
    shadow: Shadow | None


def claim_of(passage: Passage) -> Claim:
    """Return a passage as it is looked at."""
    values = summary_values(passage.summary)
    return Claim(passage, values, marks_of(passage, values))


def groups_of(places: Iterable[int], claims: Sequence[Claim], judges: Judges) -> Iterable[list[int]]:
    """Return the places of claims that the same models answer together: one feature table, and mostly all sections."""
    groups: dict[tuple[str, str | None, str | None], list[int]] = {}
    shadow = None if judges.shadow is None else judges.shadow.model
    group_of: dict[tuple[str, str], list[int]] = {}
    for i in places:
        passage = claims[i].passage
        asked = passage.summary.table_digest, passage.section_id
        group = group_of.get(asked)
        if group is None:
            key = asked[0], _special_to(judges.live, *asked), _special_to(shadow, *asked)
            group = group_of[asked] = groups.setdefault(key, [])
        group.append(i)
    return groups.values()


def _special_to(model: FrictionModel | None, table_digest: str, section_id: str) -> str | None:
    """Return the section that a bundle has a model of its own for, if it is this one."""
    manifest = None if model is None else model.manifest.model_for(table_digest, section_id=section_id)
    return None if manifest is None else manifest.section_id


def judged_claims(
    claims: Sequence[Claim], states: Sequence[SectionState], judges: Judges, *, unix_s: float, window_s: float
) -> list[PassageEntry | Rejected]:
    """Return what is to be stored of each claim, or why it is refused.

    Args:
        claims: One group of `groups_of`, at least one, as `rsu_app.domain.plausibility.misdirection` lets them through.
        states: Of the section of each.
        judges: Whom to ask.
        unix_s: When they came, by the wall clock.
        window_s: How long a passage counts.
    """
    values = np.stack([claim.values for claim in claims])
    refusals = implausibilities([claim.passage for claim in claims], values, [state.section for state in states])
    possible = [i for i, refusal in enumerate(refusals) if refusal is None]
    results: list[PassageEntry | Rejected | None] = [*refusals]
    if possible:
        table_digest = claims[0].passage.summary.table_digest
        heard = _heard(table_digest, values[possible], [states[i] for i in possible], judges)
        for place, i in enumerate(possible):
            results[i] = (
                heard
                if isinstance(heard, Rejected)
                else _entry(claims[i], heard, place, unix_s=unix_s, window_s=window_s)
            )
    return [result for result in results if result is not None]


class _Heard(NamedTuple):
    bundle_id: str
    live: list[Judgement]
    shadow_bundle_id: str | None
    beside: list[Judgement | None]


def _heard(
    table_digest: str, values: NDArray[np.float32], states: Sequence[SectionState], judges: Judges
) -> _Heard | Rejected:
    """Return what the models say of passages that can have happened, or that none can."""
    if judges.live is None:
        return Rejected(Reason.NO_MODEL, "this unit has no model yet")
    try:
        live = answers_of(table_digest, values, states, judges.live)
    except BundleError as error:
        return Rejected(Reason.NO_MODEL, str(error))
    bundle_id, shadow = judges.live.manifest.bundle_id, judges.shadow
    judgements = [answer.judgement for answer in live if answer.judgement is not None]
    if shadow is None:
        return _Heard(bundle_id, judgements, None, [None] * len(live))
    beside = asked_beside(table_digest, values, states, shadow, live)
    return _Heard(bundle_id, judgements, shadow.model.manifest.bundle_id, beside)


def _entry(claim: Claim, heard: _Heard, place: int, *, unix_s: float, window_s: float) -> PassageEntry:
    passage, judged, beside = claim.passage, heard.live[place], heard.beside[place]
    estimate = StoredEstimate(
        passage_id=passage.passage_id,
        section_id=passage.section_id,
        content_digest=claim.marks.content_digest,
        values_digest=claim.marks.values_digest,
        mu=judged.mu,
        flags=together(judged.flags, age_flag(passage.age_s, window_s=window_s)),
        left_unix_s=unix_s - passage.age_s,
        bundle_id=heard.bundle_id,
        expected_error_ratio=judged.expected_error_ratio,
        mu_low=judged.mu_low,
        at_least=judged.at_least,
        shadow_bundle_id=heard.shadow_bundle_id,
        shadow_mu=None if beside is None else beside.mu,
    )
    return PassageEntry(passage, claim.values, received_unix_s=unix_s, estimate=estimate)
