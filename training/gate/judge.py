"""Challenger against champion: everything that is asked, in order."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from typing import TypeAlias

import numpy as np

from roadgrip.features import FeatureTable
from roadgrip.units import FloatArray
from training.dataset import Runs
from training.gate import calibration, drift, envelope, groups, intervals, measured, monotone, paired, parity, speed
from training.gate.contender import Case, Contender, answers_of
from training.gate.thresholds import MEASURED_ROLE, ORDINARY_ROLES, ROLES, Thresholds, ThresholdsError
from training.gate.verdict import Check, Found, HeldOut, Verdict, check_of, in_six_digits

Step: TypeAlias = tuple[str, Callable[[], Found]]
OnStep: TypeAlias = Callable[[str, int, int], None]
"""Called with what is done next, how many steps are done, and how many there are."""


@dataclass(frozen=True, slots=True)
class Bout:
    """Who is judged, by what.

    Attributes:
        challenger: Who wants the place.
        champion: Who has it; None without one.
        holdouts: All rows of each hold-out, by role.
        thresholds: What is asked.
        label_sd_mu: Standard deviation of each label of the measured hold-out; None where labels are exact. (n,)
        rng: Source of chance.
        clock: What times answers.
    """

    challenger: Contender
    champion: Contender | None
    holdouts: Mapping[str, Runs]
    thresholds: Thresholds
    label_sd_mu: FloatArray | None
    rng: np.random.Generator
    clock: speed.Clock


def judge(
    challenger: Contender,
    champion: Contender | None,
    holdouts: Mapping[str, Runs],
    thresholds: Thresholds,
    *,
    rng: np.random.Generator,
    made_unix_s: float,
    label_sd_mu: FloatArray | None = None,
    clock: speed.Clock = time.perf_counter,
    on_step: OnStep | None = None,
) -> Verdict:
    """Return what the gate says of a challenger.

    The models for the newest feature table that it serves are judged in full, those for older ones by their errors.

    Args:
        challenger: Who wants the place.
        champion: Who has it; without one limits are absolute.
        holdouts: Drives that neither learned from, by role (`training.gate.thresholds.ROLES`).
        thresholds: What is asked.
        rng: Source of chance: draws roads, batches, rows.
        made_unix_s: When this is.
        label_sd_mu: Standard deviation of each label of the measured hold-out; NaN where one is exact. (rows of it,)
        clock: What times answers.
        on_step: Called before each step.

    Raises:
        ThresholdsError: A hold-out has a role that does not exist.
    """
    if unknown := set(holdouts) - set(ROLES):
        raise ThresholdsError(f"a hold-out is for {min(unknown)}; there are {', '.join(ROLES)}")
    bout = Bout(challenger, champion, holdouts, thresholds, label_sd_mu, rng, clock)
    steps = list(_steps(bout))
    found: list[Found] = []
    for number, (what, step) in enumerate(steps):
        if on_step is not None:
            on_step(what, number, len(steps))
        found.append(step())
    return Verdict(
        challenger=challenger.manifest.bundle_id,
        champion=None if champion is None else champion.manifest.bundle_id,
        checks=tuple(check for part in found for check in part.checks),
        holdouts=tuple(
            HeldOut(role, holdouts[role].digest(), len(holdouts[role]), int(holdouts[role].usable.sum()))
            for role in ROLES
            if role in holdouts
        ),
        thresholds=thresholds,
        pictures=tuple(in_six_digits(picture) for part in found for picture in part.pictures),
        made_unix_s=made_unix_s,
        software_version=version("roadgrip"),
    )


def _steps(bout: Bout) -> Iterator[Step]:
    """Return everything that is asked; what drives say is asked once and kept while it is needed."""
    newest = bout.challenger.tables[0]
    ordinary: list[Case] = []
    yield "hold-outs and feature tables", lambda: Found((*_holdout_checks(bout, newest), *_serves_checks(bout)))
    for role in ROLES:
        if role in bout.holdouts and bout.holdouts[role].usable.any():
            for table in bout.challenger.tables:
                if bout.holdouts[role].table.covers(table):
                    yield f"{role.replace('_', ' ')}, table {table.version}", _case_step(bout, role, table, ordinary)
    yield "intervals", lambda: intervals.interval_error(ordinary, bout.thresholds.interval, seed=_seed(bout))
    yield (
        "ONNX parity",
        lambda: parity.onnx_parity(bout.challenger, bout.holdouts, bout.thresholds.parity, rng=bout.rng),
    )
    yield "speed and size", lambda: _speed(bout, newest)
    yield (
        "slip",
        lambda: monotone.monotone_sanity(
            bout.challenger, {case.title: case.runs for case in ordinary}, bout.thresholds.monotone, rng=bout.rng
        ),
    )
    yield (
        "drift",
        lambda: drift.drift(bout.challenger, {case.title: case.runs for case in ordinary}, bout.thresholds.drift),
    )


def _case_step(bout: Bout, role: str, table: FeatureTable, ordinary: list[Case]) -> Callable[[], Found]:
    def step() -> Found:
        case = _case(bout, role, table)
        is_newest = table == bout.challenger.tables[0]
        if is_newest and role in ORDINARY_ROLES:
            ordinary.append(case)
        return _of_case(bout, case, in_full=is_newest)

    return step


def _case(bout: Bout, role: str, table: FeatureTable) -> Case:
    runs = bout.holdouts[role]
    usable = np.flatnonzero(runs.usable)
    told = runs.rows(usable).for_table(table)
    challenger = answers_of(bout.challenger, told)
    if challenger is None:
        raise ThresholdsError(f"the challenger does not serve feature table {table.digest}")
    sds = bout.label_sd_mu if role == MEASURED_ROLE else None
    return Case(
        role=role,
        runs=told,
        challenger=challenger,
        champion=None if bout.champion is None else answers_of(bout.champion, told),
        label_sd_mu=None if sds is None else sds[usable],
    )


def _of_case(bout: Bout, case: Case, *, in_full: bool) -> Found:
    limits = bout.thresholds
    slack_ratio = 1.0 if in_full else limits.older_tables.slack_ratio
    required = case.role != MEASURED_ROLE or len(case.runs) >= limits.measured.required_from_count
    parts = [
        paired.paired_error(case, limits.paired, slack_ratio=slack_ratio, required=required, rng=bout.rng),
        groups.worst_group(case, limits.groups, slack_ratio=slack_ratio, required=required),
    ]
    if in_full:
        of_ordinary = case.role in ORDINARY_ROLES
        parts.append(calibration.calibration(case, limits.calibration, required=of_ordinary))
        strange = envelope.envelope(case, limits.envelope)
        single = [] if strange is None else [strange]
        if of_ordinary:
            single.append(_answered(case, limits))
        if case.role == MEASURED_ROLE:
            single.append(measured.measured_truth(case, limits.measured))
        parts.append(Found(tuple(single)))
    return Found(
        tuple(check for part in parts for check in part.checks),
        tuple(picture for part in parts for picture in part.pictures),
    )


def _holdout_checks(bout: Bout, newest: FeatureTable) -> Iterator[Check]:
    limits, provenance = bout.thresholds.holdouts, bout.challenger.manifest.provenance
    for role in (role for role in ROLES if role in limits.required or role in bout.holdouts):
        runs = bout.holdouts.get(role)
        required = role in limits.required
        count = 0 if runs is None else int(runs.usable.sum())
        fits = runs is not None and runs.table.covers(newest)
        learned = runs is not None and any(runs.digest() in value for value in provenance.values())
        if runs is None:
            said = "there is none"
        elif not fits:
            said = f"it has feature table {runs.table.version}, which lacks columns of {newest.version}"
        elif learned:
            said = "the challenger says that it learned from it"
        else:
            said = f"{count} usable drives of {len(runs)}, {limits.fewest_rows_count} at least"
        yield check_of(
            "holdout",
            role.replace("_", " "),
            passed=fits and not learned and (count >= limits.fewest_rows_count or not required),
            required=required or learned,
            figures={"usable_count": count},
            limits={"usable_count": limits.fewest_rows_count} if required else {},
            sentence=said,
        )


def _serves_checks(bout: Bout) -> Iterator[Check]:
    """Cars live for years: what is served today stays served."""
    ours = set(bout.challenger.manifest.table_digests)
    theirs = () if bout.champion is None else bout.champion.manifest.table_digests
    missing = [digest for digest in theirs if digest not in ours]
    said = f"it serves {', '.join(sorted(ours))}"
    if missing:
        said += f", and no longer {', '.join(missing)}, which cars on the road still send"
    yield check_of(
        "serves",
        "bundle",
        passed=not missing,
        figures={"tables_count": len(ours), "missing_count": len(missing)},
        limits={"missing_count": 0},
        sentence=said,
    )


def _answered(case: Case, limits: Thresholds) -> Check:
    share, limit = float(case.challenger.unbelievable.mean()), limits.holdouts.unanswered_frac
    return check_of(
        "answers",
        case.title,
        passed=share <= limit,
        figures={"unbelievable_frac": share},
        limits={"unbelievable_frac": limit},
        sentence=(
            f"{100 * share:.2f} % of the drives get no answer, or one that no unit would believe; "
            f"{100 * limit:g} % at most"
        ),
    )


def _speed(bout: Bout, newest: FeatureTable) -> Found:
    limits = bout.thresholds.speed
    checks = (speed.size(bout.challenger, bout.champion, limits),)
    rows = next(
        (
            runs.for_table(newest).features[runs.usable]
            for runs in bout.holdouts.values()
            if runs.table.covers(newest) and runs.usable.any()
        ),
        None,
    )
    if rows is None:
        nothing = check_of("latency", "bundle", passed=False, sentence="there is no drive to ask about")
        return Found((*checks, nothing))
    found = speed.latency(bout.challenger, bout.champion, rows, limits, clock=bout.clock)
    return Found((*found.checks, *checks))


def _seed(bout: Bout) -> int:
    return int(bout.rng.integers(2**31))
