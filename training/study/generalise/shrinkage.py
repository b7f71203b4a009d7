"""What a regressor makes of a friction, learned from roads it had not seen; and what passages then say together."""

from __future__ import annotations

import numpy as np

from roadgrip.units import FloatArray
from rsu_app.domain.profiles import ProfilePolicy, evidence_of_profiles, new_tyre_grid_mu
from rsu_app.domain.shrinkage import Shrinkage, Unshrunk
from rsu_app.domain.wear import estimate_density

LEVELS_COUNT = 12
LEVEL_TAIL_FRAC = 0.01
"""The levels of the expected error reach over all passages but this share at either end."""
KERNEL_WIDTH_RATIO = 0.25
"""Standard deviation, in ln of the expected error, of the weight with which a passage speaks for a level."""
LEAST_SLOPE_RATIO = 0.15
"""A regressor that follows the friction by less is taken to follow it by this: what it says then is noise anyway."""
LEAST_NOISE_RATIO = 0.02
"""Nobody is believed to be surer."""
OUTLIER_FRAC = 0.05
"""Share of estimates that have nothing to do with the road."""
OUTLIER_DENSITY = 0.3
"""They lie anywhere between 0.05 and 1.5, evenly in ln mu."""
NOISE_STEP_RATIO = 0.05
"""Noises that differ by less are taken for one."""
TEMPER_EXPONENTS = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)


def learned_shrinkage(mu: FloatArray, *, expected_error_ratio: FloatArray, label_mu: FloatArray) -> Shrinkage:
    """Return how estimates follow the friction, by the error to expect of them.

    About each of some levels of the expected error, a line of ln estimate over ln friction by least squares; passages
    weigh by how near their expected error is.

    Args:
        mu: Estimates of passages on roads that the regressor had not seen. (n,)
        expected_error_ratio: The error to expect of each, learned on other roads, too. (n,)
        label_mu: What they found. (n,)
    """
    at, truth, answer = np.log(expected_error_ratio), np.log(label_mu), np.log(mu)
    lowest, highest = np.quantile(at, [LEVEL_TAIL_FRAC, 1.0 - LEVEL_TAIL_FRAC]).tolist()
    level = np.linspace(lowest, highest, LEVELS_COUNT)
    columns = []
    for centre in level.tolist():
        weight = np.exp(-0.5 * ((at - centre) / KERNEL_WIDTH_RATIO) ** 2)
        weight /= weight.sum()
        usual, usual_answer = float(weight @ truth), float(weight @ answer)
        spread = float(weight @ (truth - usual) ** 2)
        slope = float(weight @ ((truth - usual) * (answer - usual_answer))) / spread
        slope = max(LEAST_SLOPE_RATIO, slope)
        rest = answer - usual_answer - slope * (truth - usual)
        columns.append((usual, usual_answer, slope, max(LEAST_NOISE_RATIO, float(np.sqrt(weight @ rest**2)))))
    usual_log, answer_log, slopes, noises = zip(*columns, strict=True)
    return Shrinkage(
        expected_error_ratio=tuple(np.exp(level).tolist()),
        usual_mu=tuple(np.exp(usual_log).tolist()),
        usual_estimate_mu=tuple(np.exp(answer_log).tolist()),
        slope_ratio=slopes,
        noise_ratio=noises,
    )


def evidence_of_estimates(estimates: Unshrunk, *, new_mu: FloatArray) -> FloatArray:
    """Return what each estimate says of the friction of a new tyre, as logarithms that may be added up.

    Wear is even in [0.8, 1], noise normal, a share of outliers lies anywhere. Finite wherever the estimate is.

    Args:
        estimates: Finite. (n,)
        new_mu: Frictions of a new tyre. (m,)

    Returns:
        One line per estimate. (n, m)
    """
    noise = np.maximum(estimates.noise_ratio, LEAST_NOISE_RATIO)
    step = np.rint(np.log(noise) / NOISE_STEP_RATIO)
    evidence_values = np.empty((len(noise), len(new_mu)))
    for one in np.unique(step).tolist():
        rows = step == one
        log_ratio = np.log(estimates.mu[rows])[:, None] - np.log(new_mu)
        density = estimate_density(log_ratio, noise_ratio=float(np.exp(one * NOISE_STEP_RATIO)))
        evidence_values[rows] = np.log((1.0 - OUTLIER_FRAC) * density + OUTLIER_FRAC * OUTLIER_DENSITY)
    return evidence_values


def learned_temper_exponent(
    log_likelihood_values: FloatArray, *, grid_mu: FloatArray, base_friction_mu: FloatArray
) -> float:
    """Return how far profiles are to be believed: the exponent under which the truth is least of a surprise.

    Each profile is made a density of ln mu_new; the exponent with the greatest mean log density at the truth is taken.

    Args:
        log_likelihood_values: The profiles of passages on roads with known friction. (n, k)
        grid_mu: Friction of their points. (k,)
        base_friction_mu: What the road offered a new tyre. (n,)
    """
    new_mu = new_tyre_grid_mu(grid_mu)
    place = np.clip(np.searchsorted(new_mu, base_friction_mu), 0, len(new_mu) - 1)
    scores = []
    for exponent in TEMPER_EXPONENTS:
        lines = evidence_of_profiles(
            log_likelihood_values, grid_mu=grid_mu, policy=ProfilePolicy(temper_exponent=exponent)
        )
        at_truth = lines[np.arange(len(lines)), place] - np.log(np.exp(lines).mean(axis=1))
        scores.append(float(at_truth.mean()))
    return TEMPER_EXPONENTS[int(np.argmax(scores))]


def spread_ratio(evidence_values: FloatArray, *, new_mu: FloatArray) -> FloatArray:
    """Return the standard deviation of ln mu_new under each line of evidence, none known before. (n,)

    Args:
        evidence_values: Logarithms, one line per passage. (n, m)
        new_mu: Frictions in even steps of the logarithm. (m,)
    """
    mass = np.exp(evidence_values - evidence_values.max(axis=1, keepdims=True))
    mass /= mass.sum(axis=1, keepdims=True)
    log_mu = np.log(new_mu)
    middle = mass @ log_mu
    spread: FloatArray = np.sqrt(np.maximum(mass @ log_mu**2 - middle**2, 0.0))
    return spread
