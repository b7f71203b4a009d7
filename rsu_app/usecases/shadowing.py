"""Asking two models about one passage: the live one is heard, the other is compared."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadgrip.errors import BundleError
from rsu_app.domain.judgement import Judgement
from rsu_app.domain.shadow import Answer, ShadowRecord
from rsu_app.ports import FrictionModel
from rsu_app.usecases.section_state import SectionState, judged_values


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


def answers_of(
    table_digest: str, values: NDArray[np.float32], states: Sequence[SectionState], model: FrictionModel
) -> list[Answer]:
    """Return what a model says of passages, and how long each took: its share of the whole.

    Args:
        table_digest: The feature table of their summaries.
        values: Of passages that can have happened. (n, k)
        states: Of the section of each.
        model: Whom to ask.

    Raises:
        BundleError: It has no model for their feature table, or does not answer.
    """
    started_s = time.perf_counter()
    judged = judged_values(table_digest, values, states, model)
    took_s = (time.perf_counter() - started_s) / len(judged)
    return [Answer(each, took_s) for each in judged]


def asked_beside(
    table_digest: str,
    values: NDArray[np.float32],
    states: Sequence[SectionState],
    shadow: Shadow,
    live: Sequence[Answer],
) -> list[Judgement | None]:
    """Return what the model beside says, None where it does not answer, after both answers were compared.

    Whatever goes wrong with it stays with it: the passages have their estimates already.

    Args:
        table_digest: The feature table of their summaries.
        values: Of passages that can have happened. (n, k)
        states: Of the section of each.
        shadow: Whom to ask.
        live: What the live model made of each.
    """
    try:
        beside = answers_of(table_digest, values, states, shadow.model)
    except (BundleError, ValueError):
        beside = [Answer(None, 0.0)] * len(live)
    for its, heard in zip(beside, live, strict=True):
        newer, older = (its, heard) if shadow.newer else (heard, its)
        shadow.record.add(newer=newer, older=older)
    return [answer.judgement for answer in beside]
