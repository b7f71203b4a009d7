"""Our figures beside what others have published, as far as numbers are public, and what can be compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import by_group, relative_rms_ratio, rms_mu
from training.study.chapter import Cell as TableCell
from training.study.chapter import Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.folds import PAPER_SET, paper_estimates, rows_by_name
from training.study.picture import Axis, Bars
from training.study.recipes import SPEED_ONLY_RECIPE
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import SensorGrade

DRIVES_COUNT = 21
"""Test runs of the commercial service that are public."""
SERVICE_MEAN_FRAC = 0.1481
SERVICE_MEDIAN_FRAC = 0.1133
"""Relative RMS of the service's test runs, as the paper works them out from the thesis that measured them."""
PAPER_RMS_FRAC = 0.05
"""The paper's own, at most."""


@dataclass(frozen=True, slots=True)
class Work:
    """A published method.

    Attributes:
        name: Who and what.
        data: What it was tried on.
        number: What is public of its accuracy.
        comparable: What the number can be held against here.
    """

    name: str
    data: str
    number: str
    comparable: str


WORKS: tuple[Work, ...] = (
    Work(
        "NIRA Dynamics' service, measured by Andreasson (bachelor thesis, Luleå, 2017)",
        "one car, 21 test drives on snow and ice of changing friction, truth by a friction wheel",
        "RMS relative to the mean friction of a drive: 14.81 % on average, 11.33 % in the median (worked out by the "
        "paper from table 6.1 of the thesis)",
        "in spirit only: real roads against simulation, an error along a drive against one number a passage, snow and "
        "ice against 0.16 to 0.7",
    ),
    Work(
        "The paper (Langstrand and Rabi)",
        "44,000 simulated passages of four scenarios, one car, exact sensors",
        "RMS at most 5 % of the truth for single vehicles; 6 to 10 % worst error of the interval of 50",
        "directly: the same test matrix, on reconstructed roads in another simulator",
    ),
    Work(
        "Lampe, Ziaukas and others: LSTM (2022)",
        "extreme manoeuvres (slalom, lane change, ninety-degree turn, sine wave), as the paper tells",
        "box plots of RMS errors in a figure; no table that we could read",
        "the paper compares boxes by eye and calls it superficial: they are of RMS errors, its own of absolute "
        "errors, on manoeuvres that its regressor never saw. See the chapter on extreme manoeuvres",
    ),
    Work(
        "Hanyang University: ANN (2018)",
        "extreme manoeuvres; what the paper says of it is all we have",
        "no number that we could read",
        "only through the paper's remark that its own error is slightly smaller",
    ),
)


def drive_rms_ratio(
    rng: np.random.Generator, truth_mu: FloatArray, estimate_mu: FloatArray, *, drives_count: int, passages_count: int
) -> FloatArray:
    """Return the RMS error relative to the mean truth of made-up drives, as the service's were judged. (drives,)

    A drive of the service goes over many stretches of different friction. The nearest that single passages come to it
    is a group of them, drawn at random.

    Args:
        rng: Source of chance.
        truth_mu: Of all passages. (n,)
        estimate_mu: The same. (n,)
        drives_count: Groups.
        passages_count: Passages in each.
    """
    drawn = rng.integers(len(truth_mu), size=(drives_count, passages_count))
    rms: FloatArray = np.sqrt(np.mean((truth_mu - estimate_mu)[drawn] ** 2, axis=1))
    return rms / truth_mu[drawn].mean(axis=1)


MADE_UP_DRIVES_COUNT = 2000
PASSAGES_PER_DRIVE_COUNT = 20


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return our figures in the measures of others with one grade of sensors."""
    runs = bench.runs(PAPER_SET, grade)
    rows = rows_by_name(runs)
    truth_mu = runs.labels["label_mu"][rows]
    scenario = [runs.scenario[row] for row in rows.tolist()]
    estimate_mu = paper_estimates(bench, grade)[rows]
    speed_mu = paper_estimates(bench, grade, features=SPEED_ONLY_RECIPE.features, recipe=SPEED_ONLY_RECIPE)[rows]
    drives = drive_rms_ratio(
        np.random.default_rng(bench.seed),
        truth_mu,
        estimate_mu,
        drives_count=MADE_UP_DRIVES_COUNT,
        passages_count=PASSAGES_PER_DRIVE_COUNT,
    )
    by_scenario = by_group(relative_rms_ratio, scenario, truth_mu=truth_mu, estimate_mu=estimate_mu)
    figures = {
        "relative_rms": relative_rms_ratio(truth_mu, estimate_mu),
        "relative_rms.worst_scenario": max(by_scenario.values()),
        "relative_rms.speed_only": relative_rms_ratio(truth_mu, speed_mu),
        "rms_mu": rms_mu(truth_mu, estimate_mu),
        "drive_rms.mean": float(drives.mean()),
        "drive_rms.median": float(np.median(drives)),
        "published.service.mean": SERVICE_MEAN_FRAC,
        "published.service.median": SERVICE_MEDIAN_FRAC,
    }
    return Result(
        figures=figures,
        sizes={
            "runs": len(rows),
            "made-up drives": MADE_UP_DRIVES_COUNT,
            "passages of each": PASSAGES_PER_DRIVE_COUNT,
            "drives of the service": DRIVES_COUNT,
            "seed": bench.seed,
        },
        tables=(_works_table(), _ours_table(figures, by_scenario)),
        pictures=(_picture(figures, grade),),
    )


def _picture(figures: Mapping[str, float], grade: SensorGrade) -> Bars:
    shown = {
        "NIRA: mean drive": SERVICE_MEAN_FRAC,
        "here: mean drive": figures["drive_rms.mean"],
        "NIRA: median drive": SERVICE_MEDIAN_FRAC,
        "here: median drive": figures["drive_rms.median"],
        "paper: a passage, at most": PAPER_RMS_FRAC,
        "here: a passage": figures["relative_rms"],
    }
    return Bars(
        f"Relative RMS beside the public figure of a service, {grade} sensors",
        "what",
        Axis("RMS relative to the truth in %", low=0.0),
        tuple(shown),
        (("relative RMS", tuple(map(per_cent, shown.values()))),),
    )


def _works_table() -> Table:
    return Table(
        "What others have published",
        ("work", "tried on", "public figure", "comparable with"),
        tuple((work.name, work.data, work.number, work.comparable) for work in WORKS),
        note="Nothing here was measured by us; works without a number say so.",
    )


def _ours_table(figures: Mapping[str, float], by_scenario: Mapping[str, float]) -> Table:
    rows: list[tuple[TableCell, ...]] = [
        ("relative RMS, single passages", per_cent(figures["relative_rms"]), "paper: at most 5 %"),
        *((f"the same, {name}", per_cent(value), "") for name, value in by_scenario.items()),
        ("the same, speed only", per_cent(figures["relative_rms.speed_only"]), ""),
        ("RMS over the mean truth of a made-up drive, mean", per_cent(figures["drive_rms.mean"]), "NIRA: 14.81 %"),
        ("the same, median", per_cent(figures["drive_rms.median"]), "NIRA: 11.33 %"),
    ]
    return Table(
        "The paper's configuration here, in the same measures, in %",
        ("measure", "here", "published"),
        tuple(rows),
        note=(
            f"By regressors that had not seen the run. A made-up drive is {PASSAGES_PER_DRIVE_COUNT} passages drawn "
            "from all roads and frictions."
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return what became of the paper's claim to be twice as good as a commercial service."""
    figures = results[leading_grade(results)].figures
    ratio = SERVICE_MEDIAN_FRAC / figures["drive_rms.median"]
    claim = Claim.NOT_TESTABLE
    text = (
        f"The paper: RMS at most 5 % of the truth, hence at least twice as good as the only commercial service with "
        f"public figures. Here the relative RMS of single passages is {by_grade(results, 'relative_rms')}, in the "
        f"worst scenario {by_grade(results, 'relative_rms.worst_scenario')}; over made-up drives in the service's "
        f"measure the median is {by_grade(results, 'drive_rms.median')} against its 11.33 %, which is {ratio:.2g} "
        f"times as good ({leading_grade(results)} sensors). The comparison cannot be tested: the service was measured "
        "on real ice with an imperfect truth, ours is a simulation that learned from the very roads it is judged on. "
        "The LSTM and ANN works have no figure that we could read, so the remark that the paper's error is slightly "
        "smaller than theirs is left as it stands."
    )
    return Verdict(claim, text)


CHAPTER = Chapter(
    name="published",
    title="Beside published figures",
    paper_says=(
        "21 public test drives of a commercial service, NIRA's, come to a relative RMS error of 14.81 % on average "
        "and 11.33 % in the median; the paper's stays below 5 % and is called at least twice as good. On extreme "
        "manoeuvres its error is slightly smaller than that of the LSTM and ANN works it cites, a comparison it calls "
        "superficial: their boxes are of RMS errors, its own of absolute ones."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)
