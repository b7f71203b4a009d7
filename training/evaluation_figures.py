"""What an evaluation comes to: one row per drive, errors by section and friction, intervals as the unit places them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from roadgrip.records import FrictionInterval, NotCounted, QualityFlag
from rsu_app.domain.interval import IntervalPolicy, friction_interval

BAND_MU = 0.1
"""Width of a band of friction."""
SUREST_FRAC = 0.8


class Ending(StrEnum):
    """What became of a recorded drive."""

    COUNTED = "counted"
    """The unit would have stored and counted it."""
    NOT_COUNTED = "not_counted"
    """It has an estimate, but the unit would not have let it move the interval; the flags say why."""
    REFUSED_BY_UNIT = "refused_by_unit"
    """The summary cannot be true."""
    REFUSED_BY_VEHICLE = "refused_by_vehicle"
    """The onboard client would have kept it to itself."""
    UNREADABLE = "unreadable"
    """The file is no trace, or what is said of it contradicts itself."""


@dataclass(frozen=True, slots=True)
class EvaluatedPassage:
    """One row of the result.

    Attributes:
        name: Of the drive.
        group: Of the drive.
        section_id: Where it was; empty if on none of the sections.
        ending: What became of it.
        reason: Of the refusal, by its code; empty without one.
        detail: For a person.
        quality: What the onboard client says about its summary.
        flags: Why the unit would not count it.
        label_mu: Friction inside the section, None where nobody told it.
        estimate_mu: What the bundle says, None where it was not asked.
        expected_error_ratio: How far off the bundle expects to be; None where it does not say.
        at_least_mu: Where the estimate is doubtful, what the friction at least is; None where it is an estimate.
        step_s: Usual time between two recorded rows.
        entry_s: When it entered the section, on the recording's clock; NaN without a summary.
        exit_s: When it left it.
        mean_speed_mps: Inside the section; NaN without a summary.
        matched_by: What the match rests on; empty without a summary.
    """

    name: str
    group: str
    section_id: str
    ending: Ending
    reason: str
    detail: str
    quality: QualityFlag
    flags: NotCounted
    label_mu: float | None
    estimate_mu: float | None
    expected_error_ratio: float | None
    at_least_mu: float | None
    step_s: float
    entry_s: float
    exit_s: float
    mean_speed_mps: float
    matched_by: str

    @property
    def error_ratio(self) -> float | None:
        """Estimate over label, less one; None where one of them is missing."""
        if self.estimate_mu is None or self.label_mu is None:
            return None
        return self.estimate_mu / self.label_mu - 1.0

    @property
    def counted(self) -> bool:
        """Whether the estimate enters the interval."""
        return self.ending is Ending.COUNTED


@dataclass(frozen=True, slots=True)
class ErrorFigures:
    """How far some labelled estimates are off.

    Attributes:
        passages_count: How many.
        mape_ratio: Mean absolute error relative to the label; NaN of none.
        relative_rms_ratio: Root mean square of the errors relative to the label.
        bias_ratio: Mean error relative to the label, positive where the estimates are too high.
        worst_ratio: Largest magnitude.
    """

    passages_count: int
    mape_ratio: float
    relative_rms_ratio: float
    bias_ratio: float
    worst_ratio: float


@dataclass(frozen=True, slots=True)
class SectionInterval:
    """The interval that the counted estimates of a section, and of one group of drives, place.

    Attributes:
        section_id: The section.
        group: Of the drives; empty where none were named.
        interval: By the unit's own rule; the newest vehicle has just left.
        label_low_mu: Lowest label among the counted passages; None without labels.
        label_high_mu: Highest.
        midpoint_error_ratio: Median of the estimates over the median of the labels, less one; None unless all have one.
        labels_inside_frac: Share of the labels that lie in the interval; None without labels.
    """

    section_id: str
    group: str
    interval: FrictionInterval
    label_low_mu: float | None
    label_high_mu: float | None
    midpoint_error_ratio: float | None
    labels_inside_frac: float | None


def band_of(label_mu: float) -> str:
    """Return the band of friction that a label lies in, such as "0.2 to 0.3"; its lower end belongs to it."""
    # A label such as 0.3 shall not fall below its band for its rounding.
    lower = BAND_MU * np.floor(label_mu / BAND_MU + 1e-9)
    return f"{lower:.1f} to {lower + BAND_MU:.1f}"


def error_figures(passages: Sequence[EvaluatedPassage]) -> ErrorFigures:
    """Return how far labelled estimates are off; passages without a label or an estimate do not count."""
    errors = np.array([each.error_ratio for each in passages if each.error_ratio is not None])
    if not len(errors):
        return ErrorFigures(0, *(float("nan"),) * 4)
    return ErrorFigures(
        passages_count=len(errors),
        mape_ratio=float(np.abs(errors).mean()),
        relative_rms_ratio=float(np.sqrt((errors**2).mean())),
        bias_ratio=float(errors.mean()),
        worst_ratio=float(np.abs(errors).max()),
    )


def errors_over(labelled: Sequence[EvaluatedPassage]) -> dict[str, ErrorFigures]:
    """Return how far labelled estimates are off: all, those that count, those that do not, those trusted most.

    The surest are four fifths of those with an expected error; the name is missing where there are none.
    """
    over = {
        "all estimates": list(labelled),
        "counted": [each for each in labelled if each.counted],
        "flagged": [each for each in labelled if not each.counted],
    }
    surest = sorted(
        (each for each in labelled if each.expected_error_ratio is not None),
        key=lambda each: each.expected_error_ratio or 0.0,
    )
    if surest:
        over[f"surest {100 * SUREST_FRAC:.0f} %"] = surest[: max(1, round(SUREST_FRAC * len(surest)))]
    return {name: error_figures(passages) for name, passages in over.items() if passages}


def errors_by(
    labelled: Sequence[EvaluatedPassage], group_of: Callable[[EvaluatedPassage], str]
) -> dict[str, ErrorFigures]:
    """Return how far labelled estimates are off, group by group, in the order of the groups' names."""
    names = sorted({group_of(each) for each in labelled})
    return {name: error_figures([each for each in labelled if group_of(each) == name]) for name in names}


def section_intervals(passages: Sequence[EvaluatedPassage], policy: IntervalPolicy) -> tuple[SectionInterval, ...]:
    """Return the interval of every section and group with at least one counted estimate, by the unit's own rule."""
    found = []
    for section_id, group in sorted({(each.section_id, each.group) for each in passages if each.counted}):
        rows = [each for each in passages if each.counted and (each.section_id, each.group) == (section_id, group)]
        ordered = sorted(each.estimate_mu for each in rows if each.estimate_mu is not None)
        interval = friction_interval(ordered, newest_age_s=0.0, policy=policy)
        if interval is None:
            continue
        labels = [each.label_mu for each in rows if each.label_mu is not None]
        whole = len(labels) == len(rows)
        inside = [interval.mu_low <= label <= interval.mu_new for label in labels]
        found.append(
            SectionInterval(
                section_id=section_id,
                group=group,
                interval=interval,
                label_low_mu=min(labels, default=None),
                label_high_mu=max(labels, default=None),
                midpoint_error_ratio=interval.median_mu / float(np.median(labels)) - 1.0 if whole else None,
                labels_inside_frac=float(np.mean(inside)) if inside else None,
            )
        )
    return tuple(found)
