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
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.channels import Channel

TAIL_DEGREES = 4.0
_ROUNDS_COUNT = 3


def log_likelihood(channel: Channel, weight: FloatArray) -> FloatArray:
    """Return the logarithm of how well each friction explains a channel, up to a constant. (frictions,)

    Args:
        channel: Misfits with what may explain them.
        weight: How many independent samples each sample stands for. (n,)
    """
    misfit, variance = channel.misfit, channel.variance
    effects = np.stack([np.broadcast_to(effect, misfit.shape) for effect in channel.nuisances], axis=-1)
    prior = np.diag(1.0 / np.array(channel.priors) ** 2)
    rest = misfit
    constants: FloatArray = np.zeros((len(misfit), len(channel.priors), 1))
    certainty = weight / variance
    for _ in range(_ROUNDS_COUNT):
        trust = certainty * (TAIL_DEGREES + 1.0) / (TAIL_DEGREES + rest * rest / variance)
        weighted = np.swapaxes(trust[..., None] * effects, 1, 2)
        constants = np.linalg.solve(weighted @ effects + prior, weighted @ misfit[..., None])
        rest = misfit - (effects @ constants)[..., 0]
    unexplained = (TAIL_DEGREES + 1.0) * np.log1p(rest * rest / (TAIL_DEGREES * variance))
    unlikely = (constants[..., 0] ** 2 * np.diag(prior)).sum(axis=1)
    fit: FloatArray = -0.5 * ((unexplained * weight).sum(axis=1) + unlikely)
    return fit
