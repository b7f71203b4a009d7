"""A second opinion on somebody else's drives: recorded traces through the onboard pipeline, a bundle, the unit's rules.

What happens to a trace here is what would happen to it on the road: `vehicle_client.pipeline` summarises it or keeps it
to itself, the unit's own checks refuse it or let it pass, the model answers, the envelope says whether it counts, and
the counted estimates of a section place its interval. Nothing is learned from a label; it is compared, at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from roadgrip.errors import ConfigurationError, TraceError
from roadgrip.reasons import Reason
from roadgrip.records import KinematicSummary, NotCounted, QualityFlag, Rejected
from roadgrip.section import RoadSection
from roadgrip.units import FloatArray
from rsu_app.domain.interval import IntervalPolicy
from rsu_app.domain.judgement import Judgement
from training.evaluation_figures import (
    Ending,
    ErrorFigures,
    EvaluatedPassage,
    SectionInterval,
    band_of,
    errors_by,
    errors_over,
    section_intervals,
)
from vehicle_client.estimation.trace import Trace
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.vehicle_profile import PAPER_VEHICLE, VehicleProfile

LABEL_LIMIT_MU = 1.5
"""No tyre on a road finds more; a label above it is per cent, or something else."""
LABEL_WINDOW_M = 10.0
"""A label that changes along the road counts as its lowest moving mean over so much of the section."""


@dataclass(frozen=True, slots=True)
class RecordedDrive:
    """A trace, and what is said of it.

    Attributes:
        name: Of its file, and of the drive inside it where the file holds several.
        trace: What the sensors saw.
        vehicle: The car, as its onboard client knows it.
        friction_mu: What its tyres found at every sample; one value everywhere if only one is known; None without any.
            (n,)
        section_id: Where it is said to have been; any of the sections if empty.
        group: Drives of one group and section share an interval, such as those of an hour.
        step_s: Usual time between two recorded rows.
    """

    name: str
    trace: Trace
    vehicle: VehicleProfile = PAPER_VEHICLE
    friction_mu: FloatArray | None = None
    section_id: str = ""
    group: str = ""
    step_s: float = 0.01


@dataclass(frozen=True, slots=True)
class DrivenPassage:
    """What the onboard client made of a drive.

    Attributes:
        name: Of the drive.
        group: Of the drive.
        step_s: Of the drive.
        section: The first that it passed, or the one it came nearest to passing; None if it was on none.
        found: The summary, the client's refusal, or why there was nothing to summarise.
        label_mu: Friction inside the section, None where nobody told it.
        entry_s: When it entered the section, on the recording's clock; NaN without a summary.
        exit_s: When it left it.
        by: What the match rests on; empty without a summary.
    """

    name: str
    group: str
    step_s: float
    section: RoadSection | None
    found: KinematicSummary | Rejected | str
    label_mu: float | None
    entry_s: float = float("nan")
    exit_s: float = float("nan")
    by: str = ""


Judge: TypeAlias = Callable[[Sequence[tuple[KinematicSummary, RoadSection]]], Sequence[Judgement | Rejected]]
"""Summaries with their sections in, one answer each out."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What came of it all.

    Attributes:
        passages: One per drive, in the order they came.
        errors: By what they are over: "all estimates", "counted", "flagged", "surest 80 %" where errors are expected.
        errors_by_section: Over all estimates of a section.
        errors_by_friction: Over all estimates with a label in a band such as "0.2 to 0.3".
        refusals: By who refused and the reason's code.
        intervals: By section and group.
    """

    passages: tuple[EvaluatedPassage, ...]
    errors: Mapping[str, ErrorFigures]
    errors_by_section: Mapping[str, ErrorFigures]
    errors_by_friction: Mapping[str, ErrorFigures]
    refusals: Mapping[str, int]
    intervals: tuple[SectionInterval, ...]


def check_label(label_mu: float, *, subject: str) -> None:
    """Do nothing if a label can be the friction between a tyre and a road.

    Raises:
        TraceError: It cannot; the message says what may be meant.
    """
    if not 0.0 < label_mu <= LABEL_LIMIT_MU:
        perhaps = "; is it per cent?" if label_mu > LABEL_LIMIT_MU else ""
        raise TraceError(f"{subject}: label_mu is {label_mu:g}, not above 0 and at most {LABEL_LIMIT_MU:g}{perhaps}")


def summarised_on(drive: RecordedDrive, section: RoadSection) -> Summarised | Rejected:
    """Return what the drive's own car makes of it with the map of a section."""
    car = drive.vehicle
    return summarise_passage(
        drive.trace,
        section,
        vehicle=car.geometry,
        parameters=car.parameters,
        handling=car.handling,
        noise=car.noise,
    )


def driven_passage(drive: RecordedDrive, sections: Sequence[RoadSection]) -> DrivenPassage:
    """Return what the onboard client makes of a drive.

    Each section is tried in the order given. The first that the drive passed counts. If it passed none, the first
    refusal that does not say "wrong road" is returned, else that it was on none of them.

    Args:
        drive: The drive.
        sections: The maps, at least one, ids unique.

    Raises:
        ConfigurationError: It is said to have been on a section that is not among them.
    """
    chosen = [section for section in sections if drive.section_id in {"", section.section_id}]
    if not chosen:
        known = ", ".join(section.section_id for section in sections[:8])
        more = "" if len(sections) <= 8 else f" and {len(sections) - 8} more"
        raise ConfigurationError(f"{drive.name} is said to be on section {drive.section_id!r}; given are {known}{more}")
    refused: list[tuple[RoadSection, Rejected]] = []
    for section in chosen:
        outcome = summarised_on(drive, section)
        if isinstance(outcome, Summarised):
            return DrivenPassage(
                name=drive.name,
                group=drive.group,
                step_s=drive.step_s,
                section=section,
                found=outcome.summary,
                label_mu=_label_mu(drive, outcome.match.station_m, outcome.match.inside(drive.trace.time_s)),
                entry_s=outcome.match.entry_s,
                exit_s=outcome.match.exit_s,
                by=outcome.match.method.value,
            )
        refused.append((section, outcome))
    near = next((each for each in refused if each[1].reason is not Reason.WRONG_ROAD), None)
    if near is not None:
        where, refusal = near
        on = where if len(chosen) == 1 or refusal.reason in _SAYS_WHERE else None
        return DrivenPassage(drive.name, drive.group, drive.step_s, on, refusal, _label_mu(drive, None, None))
    detail = "; ".join(f"{section.section_id}: {refusal.detail}" for section, refusal in refused[:3])
    more = "" if len(refused) <= 3 else f"; and {len(refused) - 3} sections more"
    nowhere = Rejected(Reason.WRONG_ROAD, f"{detail}{more}")
    meant = chosen[0] if len(chosen) == 1 and drive.section_id else None
    return DrivenPassage(drive.name, drive.group, drive.step_s, meant, nowhere, _label_mu(drive, None, None))


_SAYS_WHERE = frozenset({Reason.PASSAGE_ABORTED, Reason.TOO_SLOW})
"""Refusals that only a drive on the section itself can get."""


def unreadable(name: str, why: str) -> DrivenPassage:
    """Return the passage of a file that holds none."""
    return DrivenPassage(name, "", float("nan"), None, why, None)


def evaluated(driven: Sequence[DrivenPassage], judge: Judge) -> Evaluation:
    """Return what a unit with a bundle would have made of drives, and how far its estimates are from the labels.

    Args:
        driven: From `driven_passage` and `unreadable`.
        judge: Of the bundle.
    """
    asked = [
        (i, each.found, each.section)
        for i, each in enumerate(driven)
        if isinstance(each.found, KinematicSummary) and each.section is not None
    ]
    answers = judge([(summary, section) for _, summary, section in asked]) if asked else []
    told = {i: answer for (i, _, _), answer in zip(asked, answers, strict=True)}
    passages = tuple(_row(each, told.get(i)) for i, each in enumerate(driven))
    labelled = [each for each in passages if each.error_ratio is not None]
    refusals: dict[str, int] = {}
    for each in passages:
        if each.reason or each.ending is Ending.UNREADABLE:
            why = f"{each.ending.value}: {each.reason}".removesuffix(": ")
            refusals[why] = refusals.get(why, 0) + 1
    return Evaluation(
        passages=passages,
        errors=errors_over(labelled),
        errors_by_section=errors_by(labelled, lambda each: each.section_id),
        errors_by_friction=errors_by(labelled, lambda each: band_of(each.label_mu or 0.0)),
        refusals=dict(sorted(refusals.items())),
        intervals=section_intervals(passages, IntervalPolicy()),
    )


def lowest_moving_mean_mu(station_m: FloatArray, friction_mu: FloatArray) -> float:
    """Return the lowest mean of a friction over 10 m of road, or over all of it where that is shorter.

    Args:
        station_m: Along the road, not decreasing. (n,)
        friction_mu: At those places. (n,)
    """
    if friction_mu.min() == friction_mu.max():
        return float(friction_mu[0])
    window_m = min(LABEL_WINDOW_M, float(station_m[-1] - station_m[0]))
    if window_m <= 0.0:
        return float(friction_mu.min())
    steps = np.diff(station_m) * (friction_mu[1:] + friction_mu[:-1]) / 2.0
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    last_m = float(station_m[-1]) - window_m
    starts = np.append(station_m[station_m <= last_m], last_m)
    sums = np.interp(starts + window_m, station_m, integral) - np.interp(starts, station_m, integral)
    return float(sums.min() / window_m)


def _label_mu(drive: RecordedDrive, station_m: FloatArray | None, inside: np.ndarray | None) -> float | None:
    """Return the label of a drive: inside the section where it was found, else if it is one number everywhere."""
    friction = drive.friction_mu
    if friction is None:
        return None
    if station_m is not None and inside is not None:
        return lowest_moving_mean_mu(np.maximum.accumulate(station_m[inside]), friction[inside])
    return float(friction[0]) if friction.min() == friction.max() else None


def _row(driven: DrivenPassage, answer: Judgement | Rejected | None) -> EvaluatedPassage:
    found = driven.found
    quality = found.quality if isinstance(found, KinematicSummary) else QualityFlag.NONE
    reason, detail, judged = "", "", Judgement(None, NotCounted.NONE)
    if isinstance(found, str):
        ending, detail = Ending.UNREADABLE, found
    elif isinstance(found, Rejected):
        ending, reason, detail = Ending.REFUSED_BY_VEHICLE, found.reason.value, found.detail
    elif isinstance(answer, Judgement):
        judged = answer
        ending = Ending.COUNTED if judged.flags == NotCounted.NONE else Ending.NOT_COUNTED
    else:
        refusal = answer or Rejected(Reason.NO_MODEL)
        ending, reason, detail = Ending.REFUSED_BY_UNIT, refusal.reason.value, refusal.detail
    duration_s = driven.exit_s - driven.entry_s
    return EvaluatedPassage(
        name=driven.name,
        group=driven.group,
        section_id="" if driven.section is None else driven.section.section_id,
        ending=ending,
        reason=reason,
        detail=detail,
        quality=quality,
        flags=judged.flags,
        label_mu=driven.label_mu,
        estimate_mu=judged.mu,
        expected_error_ratio=judged.expected_error_ratio,
        at_least_mu=judged.mu_low if judged.at_least else None,
        step_s=driven.step_s,
        entry_s=driven.entry_s,
        exit_s=driven.exit_s,
        mean_speed_mps=float("nan") if driven.section is None else driven.section.length_m / duration_s,
        matched_by=driven.by,
    )
