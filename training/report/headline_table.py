"""The headlines beside the paper and the targets, as rows of text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from training.report.wording import percent_text
from training.study.headlines import HEADLINES
from vehicle_client.simulator.plan import SensorGrade


@dataclass(frozen=True, slots=True)
class HeadlineAt:
    """One headline with one grade of sensors, as text."""

    paper_config: str
    best: str
    target: str
    reached: bool | None


@dataclass(frozen=True, slots=True)
class HeadlineRow:
    """One headline, as text.

    Attributes:
        meaning: What it is.
        paper: What the paper has.
        by_grade: What was found, by grade of sensors.
    """

    meaning: str
    paper: str
    by_grade: Mapping[SensorGrade, HeadlineAt]


def headline_rows(summary: Mapping[str, Any]) -> tuple[HeadlineRow, ...]:
    """Return the headlines as rows; the target applies to the best model.

    Args:
        summary: As `training.study.headlines.summary` returns it.
    """
    rows = []
    for headline in HEADLINES:
        by_grade = {}
        for grade in SensorGrade:
            paper_config = summary[grade.value]["paper_config"][headline.name]
            best = summary[grade.value]["best"][headline.name]
            target = (headline.target_frac or {}).get(grade)
            sign = "\u2265 " if headline.at_least else "\u2264 "
            by_grade[grade] = HeadlineAt(
                paper_config=percent_text(paper_config),
                best=percent_text(best),
                target=percent_text(None) if target is None else sign + percent_text(target),
                reached=headline.is_reached(best, grade),
            )
        rows.append(HeadlineRow(headline.meaning, headline.paper, by_grade))
    return tuple(rows)
