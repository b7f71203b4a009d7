"""How well each friction explains a channel: a robust fit over samples, with unknown constants fitted along.

Misfits have heavy tails, since a model of two axles is wrong where tyres slide; Student's t with few degrees of freedom
lets such samples speak without deciding. The unknown constants (offsets, scales) have Gaussian priors and are fitted at
every friction by reweighted least squares.

The variance of a misfit grows with the noise of the force, which the curve turns into slip, and so depends on the
friction. Its logarithm is left out on purpose: the force is itself an unknown at every sample, and fitting it along
(orthogonal regression) is what makes the estimate right on average; with the logarithm, noise would look like grip.

References:
    Lange, Little and Taylor, Robust statistical modeling using the t distribution, JASA 84 (1989). Fuller,
    Measurement error models, section 3.2 (nonlinear models: the true regressor fitted along).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.channels import Channel

TAIL_DEGREES = 4.0
_ROUNDS_COUNT = 3


def log_likelihood(channel: Channel, weight: FloatArray) -> FloatArray:
    """Return the logarithm of how well each friction explains every sample, up to a constant. (frictions, n)

    The unknown constants are fitted to all samples; what they cost by being unlikely is shared out among those that
    count.

    Args:
        channel: Misfits with what may explain them.
        weight: How many independent samples each sample stands for. (n,)
    """
    fit: FloatArray = np.zeros_like(channel.misfit)
    counted = np.flatnonzero(weight)
    if len(counted) == 0:
        return fit
    # Parts of a drive lie in one piece: nothing is computed for what does not count before and behind.
    here = slice(int(counted[0]), int(counted[-1]) + 1)
    misfit, variance, counts = channel.misfit[:, here], channel.variance[:, here], weight[here]
    # Constants before samples: sums over samples then are products of matrices whose rows lie in one piece.
    effects = np.empty((len(misfit), len(channel.nuisances), misfit.shape[1]))
    for place, effect in enumerate(channel.nuisances):
        effects[:, place] = effect[..., here]
    by_constant = np.swapaxes(effects, 1, 2)
    prior = 1.0 / np.array(channel.priors) ** 2
    certainty = (TAIL_DEGREES + 1.0) * counts / variance
    constants: NDArray[np.floating] = np.zeros((len(misfit), len(prior), 1))
    surprise = misfit * misfit / variance
    for _ in range(_ROUNDS_COUNT):
        trust = certainty / (TAIL_DEGREES + surprise)
        weighted = trust[:, None] * effects
        constants = np.linalg.solve(weighted @ by_constant + np.diag(prior), weighted @ misfit[..., None])
        rest = misfit - (np.swapaxes(constants, 1, 2) @ effects)[:, 0]
        surprise = rest * rest / variance
    unexplained = (TAIL_DEGREES + 1.0) * np.log1p(surprise / TAIL_DEGREES)
    unlikely = constants[..., 0] ** 2 @ prior / counts.sum()
    fit[:, here] = -0.5 * counts * (unexplained + unlikely[:, None])
    return fit
