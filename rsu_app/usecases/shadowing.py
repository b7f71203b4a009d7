"""Asking two models about one passage: the live one is heard, the other is compared."""

from __future__ import annotations

import time
from dataclasses import dataclass

from roadgrip.errors import BundleError
from roadgrip.records import Passage
from rsu_app.domain.judgement import Judgement
from rsu_app.domain.shadow import Answer, ShadowRecord
from rsu_app.ports import FrictionModel
from rsu_app.usecases.section_state import SectionState, judged_passage


@dataclass(frozen=True, slots=True)
class Shadow:
    """A model that is asked about every passage beside the live one, and heard by nobody.

    Attributes:
        model: It.
        newer: Whether it is the newer of the two: a candidate, and not the one before that is kept for comparison.
        record: What both made of the same passages.
    """

    model: FrictionModel
    newer: bool
    record: ShadowRecord


def timed_judgement(passage: Passage, state: SectionState, model: FrictionModel) -> tuple[Judgement, float]:
    """Return what a model says of a passage, and how long that took, by this machine's own time.

    Raises:
        BundleError: It has no model for the passage's feature table, or does not answer.
    """
    started_s = time.perf_counter()
    judged = judged_passage(passage, state, model)
    return judged, time.perf_counter() - started_s


def asked_beside(passage: Passage, state: SectionState, shadow: Shadow, live: Answer) -> Judgement | None:
    """Return what the model beside says, None if it does not answer, after both answers were compared.

    Whatever goes wrong with it stays with it: the passage has its estimate already.

    Args:
        passage: One that can have happened.
        state: Of the section it names.
        shadow: Whom to ask.
        live: What the live model made of it.
    """
    try:
        beside = Answer(*timed_judgement(passage, state, shadow.model))
    except (BundleError, ValueError):
        beside = Answer(None, 0.0)
    newer, older = (beside, live) if shadow.newer else (live, beside)
    shadow.record.add(newer=newer, older=older)
    return beside.judgement
