"""The error of the challenger less that of the champion, on the same drives, and how sure the difference is.

Drives on one road err alike, so roads are drawn anew, each with all its drives. Where there are too few roads to draw
from, drives are drawn within theirs: that says how sure the difference is on these roads, and nothing of others.
Drives of one name, under two grades of sensors, stay together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadgrip.units import FloatArray
from training.dataset import Runs
from training.gate.contender import Case
from training.gate.thresholds import PairedThresholds
from training.gate.verdict import Check, Found, check_of
from training.regressor import RowIndices
from training.study.picture import Axis, Bars

FEWEST_CLUSTERS_COUNT = 10
"""Fewer roads or drives than these bound nothing, however often they are drawn."""
_CHUNK_COUNT = 2_000_000
_BINS_COUNT = 30


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """What is drawn as one, and among what.

    Attributes:
        cluster: Number of each row's cluster. (n,)
        stratum: Number of each cluster's stratum: it is only drawn in its stratum's place. (clusters,)
    """

    cluster: RowIndices
    stratum: RowIndices

    @property
    def by_road(self) -> bool:
        """Whether whole roads are drawn."""
        return not self.stratum.any()


def clusters_of(runs: Runs, *, fewest_sections_count: int) -> Clusters:
    """Return roads as clusters, or with fewer than so many roads the drives within them."""
    sections, section = np.unique(np.array(runs.section_id), return_inverse=True)
    if len(sections) >= fewest_sections_count:
        return Clusters(section, np.zeros(len(sections), dtype=np.intp))
    keys = np.array([f"{road}|{key}" for road, key in zip(runs.section_id, runs.run_key, strict=True)])
    _, first, cluster = np.unique(keys, return_index=True, return_inverse=True)
    # Counted from 1, so that a single road is not taken for the stratum of all roads.
    return Clusters(cluster, section[first] + 1)


def bootstrap_means(
    values: FloatArray, clusters: Clusters, *, replicates_count: int, rng: np.random.Generator
) -> FloatArray:
    """Return means over rows, each of clusters drawn with replacement within their strata. (replicates,)

    Args:
        values: Of every row. (n,)
        clusters: What is drawn as one.
        replicates_count: How often.
        rng: Source of chance.

    References:
        Davison and Hinkley, Bootstrap Methods and their Application, 1997, section 3.8.
    """
    counts = np.bincount(clusters.cluster, minlength=len(clusters.stratum))
    sums = np.bincount(clusters.cluster, weights=values, minlength=len(clusters.stratum))
    total, number = np.zeros(replicates_count), np.zeros(replicates_count)
    for stratum in np.unique(clusters.stratum).tolist():
        members = np.flatnonzero(clusters.stratum == stratum)
        chunk_count = max(1, _CHUNK_COUNT // len(members))
        for start in range(0, replicates_count, chunk_count):
            part = slice(start, min(start + chunk_count, replicates_count))
            drawn = members[rng.integers(len(members), size=(part.stop - part.start, len(members)))]
            total[part] += sums[drawn].sum(axis=1)
            number[part] += counts[drawn].sum(axis=1)
    means: FloatArray = total / number
    return means


def paired_error(
    case: Case, limits: PairedThresholds, *, slack_ratio: float, required: bool, rng: np.random.Generator
) -> Found:
    """Return whether the mean error is surely no worse than the champion's by more than is tolerated.

    Without a champion the mean error itself has a limit.

    Args:
        case: A hold-out and what is said of it.
        limits: What is asked.
        slack_ratio: So much wider are the limits.
        required: Whether the challenger fails by it.
        rng: Source of chance.
    """
    errors = case.error_ratio(case.challenger)
    if case.champion is None:
        return Found(
            (_alone(case, errors, limit_ratio=slack_ratio * limits.alone_ratio[case.role], required=required),)
        )
    champion_errors = case.error_ratio(case.champion)
    clusters = clusters_of(case.runs, fewest_sections_count=limits.fewest_sections_count)
    if len(clusters.stratum) < FEWEST_CLUSTERS_COUNT:
        sentence = f"{len(clusters.stratum)} drives are too few to compare anything; {FEWEST_CLUSTERS_COUNT} at least"
        return Found((check_of("paired_error", case.title, passed=False, required=required, sentence=sentence),))
    means = bootstrap_means(errors - champion_errors, clusters, replicates_count=limits.replicates_count, rng=rng)
    low, upper = np.quantile(means, [1.0 - limits.confidence_frac, limits.confidence_frac]).tolist()
    tolerance, mean = slack_ratio * limits.tolerance_ratio[case.role], float((errors - champion_errors).mean())
    better = "surely better" if upper < 0.0 else "surely worse" if low > 0.0 else "neither surely better nor worse"
    drawn = "roads" if clusters.by_road else "drives within their roads"
    check = check_of(
        "paired_error",
        case.title,
        passed=upper <= tolerance,
        required=required,
        figures={
            "error_ratio": float(errors.mean()),
            "champion_error_ratio": float(champion_errors.mean()),
            "difference_ratio": mean,
            "difference_low_ratio": low,
            "difference_upper_ratio": upper,
            "clusters_count": len(clusters.stratum),
        },
        limits={"difference_upper_ratio": tolerance},
        sentence=(
            f"mean error {100 * errors.mean():.2f} %, the champion's {100 * champion_errors.mean():.2f} %: {better}; "
            f"at {100 * limits.confidence_frac:g} % at most {100 * upper:+.2f} points, "
            f"{100 * tolerance:+.2f} tolerated ({len(clusters.stratum)} {drawn} drawn)"
        ),
    )
    return Found((check,), (_picture(case, means),))


def _alone(case: Case, errors: FloatArray, *, limit_ratio: float, required: bool) -> Check:
    mean = float(errors.mean())
    return check_of(
        "paired_error",
        case.title,
        passed=mean <= limit_ratio,
        required=required,
        figures={"error_ratio": mean},
        limits={"error_ratio": limit_ratio},
        sentence=f"mean error {100 * mean:.2f} %; there is no champion, {100 * limit_ratio:.2f} % at most",
    )


def _picture(case: Case, means: FloatArray) -> Bars:
    heights, edges = np.histogram(100.0 * means, bins=_BINS_COUNT)
    middles: NDArray[np.float64] = (edges[:-1] + edges[1:]) / 2.0
    return Bars(
        title=f"Mean error less the champion's, {case.title}: below zero the challenger is better",
        x_title="difference, points of per cent",
        y_axis=Axis("share of replicates"),
        names=tuple(f"{middle:.3f}" for middle in middles.tolist()),
        groups=(("challenger less champion", tuple((heights / len(means)).tolist())),),
    )
