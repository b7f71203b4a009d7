"""The algorithms that the paper compares, each as a learner. One thread each: folds learn side by side.

The paper gives all of them 100 estimators of depth 6 where they have such a thing, squared errors, and says no more.
Whatever else there is to set is as the library has it, except where that would make an algorithm lose for no merit of
the others: kernels and networks get inputs and friction scaled to mean 0 and deviation 1, and the support vector
machine a tube and a penalty that suit errors of a few per cent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xgboost

from roadgrip.units import FloatArray
from training.study.recipes import Estimator

ESTIMATORS_COUNT = 100
DEPTH_COUNT = 6
HIDDEN_COUNT = 100
"""Units of a hidden layer; the library's."""
MOST_EPOCHS_COUNT = 500
TUBE_WIDTH_RATIO = 0.02
"""In standard deviations of friction. The library's 0.1, unscaled, is wider than half the paper's frictions."""
PENALTY_FACTOR = 100.0


@dataclass(frozen=True, slots=True)
class SupportVectors:
    """Support vector regression with a Gaussian kernel; time grows with the square of the rows."""

    tube_width_ratio: float = TUBE_WIDTH_RATIO
    penalty_factor: float = PENALTY_FACTOR

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what was learned."""
        from sklearn.svm import SVR

        return _scaled(SVR(C=self.penalty_factor, epsilon=self.tube_width_ratio), features, label_mu)


@dataclass(frozen=True, slots=True)
class Perceptron:
    """A network of fully connected layers with rectified units, taught by Adam."""

    hidden_counts: tuple[int, ...] = (HIDDEN_COUNT,)
    seed: int = 1

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what was learned."""
        from sklearn.neural_network import MLPRegressor

        network = MLPRegressor(
            hidden_layer_sizes=self.hidden_counts, max_iter=MOST_EPOCHS_COUNT, random_state=self.seed
        )
        return _scaled(network, features, label_mu)


@dataclass(frozen=True, slots=True)
class RandomForest:
    """Trees grown deep on samples of the rows, averaged; exact splits, as scikit-learn grows them."""

    seed: int = 1

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what was learned."""
        from sklearn.ensemble import RandomForestRegressor

        return _fitted(
            RandomForestRegressor(ESTIMATORS_COUNT, max_depth=DEPTH_COUNT, random_state=self.seed), features, label_mu
        )


@dataclass(frozen=True, slots=True)
class GradientBoosting:
    """Boosted trees with exact splits: scikit-learn's `GradientBoostingRegressor`, not its histogram variant."""

    seed: int = 1

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what was learned."""
        from sklearn.ensemble import GradientBoostingRegressor

        return _fitted(
            GradientBoostingRegressor(n_estimators=ESTIMATORS_COUNT, max_depth=DEPTH_COUNT, random_state=self.seed),
            features,
            label_mu,
        )


@dataclass(frozen=True, slots=True)
class XgboostForest:
    """XGBoost's random forest: all trees in one round, each on a sample of rows and columns, averaged."""

    seed: int = 1

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what was learned."""
        forest = xgboost.XGBRFRegressor(
            n_estimators=ESTIMATORS_COUNT, max_depth=DEPTH_COUNT, n_jobs=1, random_state=self.seed
        )
        return _fitted(forest, features, label_mu)


@dataclass(frozen=True, slots=True)
class Constant:
    """One number for all: what is known without any feature. The number with the least mean relative error."""

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what was learned."""
        del features
        # Errors relative to the truth weigh each truth by its inverse: the weighted median is best.
        order = np.argsort(label_mu)
        weight = np.cumsum(1.0 / label_mu[order])
        best_mu = float(label_mu[order][np.searchsorted(weight, 0.5 * weight[-1])])
        return lambda rows: np.full(len(rows), best_mu)


def _scaled(regressor: Any, features: FloatArray, label_mu: FloatArray) -> Estimator:
    from sklearn.compose import TransformedTargetRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    whole = TransformedTargetRegressor(make_pipeline(StandardScaler(), regressor), transformer=StandardScaler())
    return _fitted(whole, features, label_mu)


def _fitted(regressor: Any, features: FloatArray, label_mu: FloatArray) -> Estimator:
    regressor.fit(features, label_mu)
    return lambda rows: np.asarray(regressor.predict(rows), dtype=np.float64)
