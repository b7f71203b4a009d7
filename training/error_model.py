"""The error to expect of an estimate: trees that add up to the logarithm of its mean magnitude.

Errors of one and the same kind of passage are as often near nothing as they are large. The mean of a logarithm would
follow the smallest ones, and trees of plain squared errors may come out below zero, which a unit takes for a model that
is lost. These follow the mean itself and answer above zero.
"""

from __future__ import annotations

import numpy as np
import xgboost

from roadgrip.units import FloatArray
from training.fit_parameters import FitParameters, Target

ERROR_FIT = FitParameters(
    trees_count=150,
    depth_count=4,
    learning_rate_ratio=0.05,
    row_share_frac=0.7,
    column_share_frac=0.4,
    target=Target.LOG_MU,
)
"""A mean of what is mostly noise: few and shallow trees do not make more of it than there is."""
LEAST_MU = 1e-3
"""Trees of friction may come out below zero, where there is no logarithm."""


def log_error_ratio(estimate_mu: FloatArray, label_mu: FloatArray) -> FloatArray:
    """Return how far estimates are off, on the logarithm: to first order relative to the truth. (n,)

    Args:
        estimate_mu: Friction. (n,)
        label_mu: The truth, positive. (n,)
    """
    return np.abs(np.log(np.maximum(estimate_mu, LEAST_MU) / label_mu))


def grow_error_trees(
    features: FloatArray, error_ratio: FloatArray, parameters: FitParameters = ERROR_FIT, *, threads_count: int = 0
) -> xgboost.Booster:
    """Return boosted trees of the magnitude of error to expect; `training.regressor.estimate_mu` asks them.

    What they lower is the deviance of a gamma distribution, whose spread grows with its mean, by Fisher's scoring on
    the logarithm of the mean.

    Args:
        features: What to learn from. (n, columns)
        error_ratio: From `log_error_ratio`, of estimates by regressors that did not learn from the passage. (n,)
        parameters: How the trees are grown; the target is a logarithm.
        threads_count: At most so many; 0 takes what there is.

    References:
        McCullagh, Nelder, Generalized Linear Models, 1989, section 8.3.
    """
    rows = xgboost.QuantileDMatrix(
        features.astype(np.float32), label=error_ratio, max_bin=parameters.bins_count, nthread=threads_count or None
    )

    def gradients(log_mean_ratio: FloatArray, grown_on: xgboost.DMatrix) -> tuple[FloatArray, FloatArray]:
        gradient = 1.0 - grown_on.get_label() * np.exp(-log_mean_ratio)
        return gradient, np.ones_like(gradient)

    booster = xgboost.train(
        {
            "max_depth": parameters.depth_count,
            "eta": parameters.learning_rate_ratio,
            "subsample": parameters.row_share_frac,
            "colsample_bytree": parameters.column_share_frac,
            "tree_method": "hist",
            "max_bin": parameters.bins_count,
            "seed": parameters.seed,
            "nthread": threads_count,
            "base_score": float(np.log(np.mean(error_ratio))),
            "min_child_weight": 5.0,
        },
        rows,
        num_boost_round=parameters.trees_count,
        obj=gradients,
    )
    booster.set_attr(target=Target.LOG_MU.value)
    return booster
