"""Recipes for regressors: which features, and how to learn from them. What is judged alike is handed over alike."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

from roadgrip.units import FloatArray
from training.fit_parameters import FitParameters
from training.regressor import estimate_mu, grow_trees
from training.study.paper_features import PAPER_FEATURES, SPEED_FEATURES

Estimator: TypeAlias = Callable[[FloatArray], FloatArray]
"""What was learned: rows of features in, (n, columns), friction out, (n,)."""
Learner: TypeAlias = Callable[[FloatArray, FloatArray], Estimator]
"""How to learn: rows of features, (n, columns), and the friction of each, (n,); several may learn at a time."""

PAPER_FIT = FitParameters(
    trees_count=100, depth_count=6, learning_rate_ratio=0.3, row_share_frac=1.0, column_share_frac=1.0
)
"""100 trees of depth 6, which the paper names; all else as the library has it, which is how it reads."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a regressor comes about.

    Attributes:
        name: For tables, pictures and files; the same name, the same recipe.
        features: What it learns from, by name.
        learn: How.
    """

    name: str
    features: tuple[str, ...]
    learn: Learner

    @property
    def key(self) -> str:
        """Name and features as something that fits a file's name."""
        digest = hashlib.sha256("\n".join(self.features).encode()).hexdigest()[:12]
        return f"{self.name.replace(' ', '-')}-{digest}"


def boosted(parameters: FitParameters) -> Learner:
    """Return the learner that grows boosted trees, one thread each: folds learn side by side."""

    def learn(features: FloatArray, label_mu: FloatArray) -> Estimator:
        booster = grow_trees(features, label_mu, parameters, threads_count=1)
        return lambda rows: estimate_mu(booster, rows, threads_count=1)

    return learn


PAPER_RECIPE = Recipe("paper", PAPER_FEATURES, boosted(PAPER_FIT))
"""The paper's regressor: 78 features, 100 trees of depth 6."""
SPEED_ONLY_RECIPE = replace(PAPER_RECIPE, name="speed only", features=SPEED_FEATURES)
"""The same from nothing but the speed: what the driver's caution alone gives away."""
