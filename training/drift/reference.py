"""How the features and estimates of a training were distributed, for a bundle's manifest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roadgrip.bundle import TrainingReference
from roadgrip.units import FloatArray

LEVELS_COUNT = 21
"""Every twentieth of the rows: ten equally likely bins, and one more level in the middle of each."""
FEWEST_ROWS_COUNT = 200
"""With fewer drives a road has no reference of its own: quantiles of them say little beyond the middle."""


def learn_references(
    features: FloatArray,
    estimate_mu: FloatArray,
    section_id: Sequence[str],
    *,
    known_sections: Sequence[str],
    levels_count: int = LEVELS_COUNT,
) -> tuple[TrainingReference, ...]:
    """Return how rows were distributed: over all roads first, then on each known road with enough of them, by name.

    The order of the rows does not matter. Figures are 32-bit numbers, as a unit holds its features, in their shortest
    decimal form.

    Args:
        features: Finite, in the order of the feature table. (n, columns)
        estimate_mu: What the model said of each row, one that had not learned from it where there is such. (n,)
        section_id: Where each was driven. (n,)
        known_sections: Roads that units will serve; others only count among all roads.
        levels_count: How many quantiles, evenly spaced from the least to the largest value.

    Raises:
        ValueError: There is no row, or a number among them is not finite.
    """
    if len(features) == 0 or not (np.isfinite(features).all() and np.isfinite(estimate_mu).all()):
        raise ValueError(f"{len(features)} rows, some with no number perhaps, are no reference")
    names = np.array(section_id)
    references = [_reference(None, features, estimate_mu, levels_count)]
    for name in sorted(set(known_sections)):
        here = names == name
        if int(here.sum()) >= FEWEST_ROWS_COUNT:
            references.append(_reference(name, features[here], estimate_mu[here], levels_count))
    return tuple(references)


def _reference(
    section_id: str | None, features: FloatArray, estimate_mu: FloatArray, levels_count: int
) -> TrainingReference:
    at = np.linspace(0.0, 1.0, levels_count)
    return TrainingReference(
        section_id=section_id,
        rows_count=len(features),
        quantiles=tuple(map(_short, np.quantile(features, at, axis=0).T)),
        mu_quantiles=_short(np.quantile(estimate_mu, at)),
    )


def _short(values: FloatArray) -> tuple[float, ...]:
    """Return numbers as the shortest decimals that are the same in 32 bits. (n,)"""
    return tuple(float(str(value)) for value in values.astype(np.float32))
