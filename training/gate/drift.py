"""Which features of the hold-outs are distributed otherwise than in the challenger's training; informs only.

The distance is the one that a unit watches its traffic by. A hold-out that has drifted is no reason to refuse a bundle.
It says that the bundle is judged on other traffic than it learned from; perhaps its training wants newer drives.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from roadgrip.bundle import ModelManifest, TrainingReference
from rsu_app.domain.drift import kolmogorov_smirnov
from training.dataset import Runs
from training.gate.contender import Contender
from training.gate.thresholds import DriftThresholds
from training.gate.verdict import Found, check_of, joined
from training.study.picture import Axis, Bars

_NAMED_COUNT = 5
_MOST_BARS_COUNT = 20


def drift(contender: Contender, holdouts: Mapping[str, Runs], limits: DriftThresholds) -> Found:
    """Return which features have drifted, for each hold-out; without references nothing can be said.

    Args:
        contender: The challenger.
        holdouts: Drives by the title of the hold-out, in the columns of its newest table, all usable.
        limits: When a feature is flagged.
    """
    return joined(_of_runs(contender, title, runs, limits) for title, runs in holdouts.items())


def _of_runs(contender: Contender, title: str, runs: Runs, limits: DriftThresholds) -> Found:
    model = contender.manifest.model_for(runs.table.digest)
    distances = {} if model is None else _distances(model, runs, limits)
    if not distances:
        sentence = "the bundle does not say how its training was distributed on such roads"
        return Found((check_of("drift", title, passed=True, required=False, sentence=sentence),))
    worst = sorted(distances, key=lambda name: -distances[name])
    flagged = [name for name in worst if distances[name] > limits.flagged_ratio]
    named = f": {', '.join(flagged[:_NAMED_COUNT])}" if flagged else ""
    check = check_of(
        "drift",
        title,
        passed=not flagged,
        required=False,
        figures={"flagged_count": len(flagged), "largest_ratio": distances[worst[0]]},
        limits={"largest_ratio": limits.flagged_ratio},
        sentence=f"{len(flagged)} of {len(distances)} features are distributed otherwise than in training{named}",
    )
    shown = worst[:_MOST_BARS_COUNT]
    picture = Bars(
        title=f"Features that differ most from training, {title}",
        x_title="feature",
        y_axis=Axis("largest distance of the distributions", low=0.0),
        names=tuple(shown),
        groups=(("distance", tuple(distances[name] for name in shown)),),
    )
    return Found((check,), (picture,))


def _distances(model: ModelManifest, runs: Runs, limits: DriftThresholds) -> dict[str, float]:
    """Return the largest distance of each feature over the references that enough drives are held against."""
    sections = np.array(runs.section_id)
    chosen: dict[str | None, tuple[TrainingReference, list[str]]] = {}
    for section_id in sorted(set(runs.section_id)):
        reference = model.reference_for(section_id)
        if reference is not None:
            chosen.setdefault(reference.section_id, (reference, []))[1].append(section_id)
    found: dict[str, float] = {}
    for reference, roads in chosen.values():
        values = runs.features[np.isin(sections, roads)]
        if len(values) >= limits.fewest_rows_count:
            for column, name in enumerate(runs.table.names):
                distance = kolmogorov_smirnov(reference.quantiles[column], values[:, column])
                found[name] = max(found.get(name, 0.0), distance)
    return found
