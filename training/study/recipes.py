"""Recipes for regressors: which features, and how to learn from them. What is judged alike is handed over alike."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, is_dataclass, replace
from typing import TypeAlias

from roadgrip.features import FEATURE_NAMES
from roadgrip.units import FloatArray
from training.code_identity import function_digest
from training.fit_parameters import FitParameters, Target
from training.regressor import estimate_mu, grow_trees
from training.study.paper_features import PAPER_FEATURES, SPEED_FEATURES

Estimator: TypeAlias = Callable[[FloatArray], FloatArray]
"""What was learned: rows of features in, (n, columns), friction out, (n,)."""
Learner: TypeAlias = Callable[[FloatArray, FloatArray], Estimator]
"""How to learn: from rows of features, (n, columns), and the friction of each, (n,); several may learn at a time.

Either a function at the top of a module or a frozen record with `__call__`: only these can be told apart by what they
do, and what was computed before is only of use to the same learner.
"""

FIRST_GUESS = "grip_all_best_mu"
"""What the physical inverse takes for the friction; trees that start from it need not learn to repeat a number."""
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

    def __post_init__(self) -> None:
        if mends_first_guess(self.learn) and self.features[:1] != (FIRST_GUESS,):
            raise ValueError(f"what mends a first guess needs {FIRST_GUESS} as its first feature")

    def on(self, features: Sequence[str], *, name: str | None = None) -> Recipe:
        """Return the same way of learning from other features; without the first guess among them, from nothing."""
        learn, chosen = self.learn, tuple(features)
        if isinstance(learn, Boosted) and mends_first_guess(learn):
            if FIRST_GUESS in chosen:
                chosen = (FIRST_GUESS, *(feature for feature in chosen if feature != FIRST_GUESS))
            else:
                learn = replace(learn, parameters=replace(learn.parameters, base_column=None))
        return Recipe(name or self.name, chosen, learn)

    @property
    def key(self) -> str:
        """What changes with name, features, way of learning and its code, short enough for a file's name.

        Raises:
            TypeError: The learner is a closure: what it holds cannot be seen from outside.
        """
        learn: object = self.learn
        held = repr(learn) if is_dataclass(learn) else ""
        place = str(getattr(learn, "__qualname__", type(learn).__qualname__))
        if "<" in place:
            raise TypeError(f"{place} is no learner: it is neither at the top of a module nor a record")
        code = function_digest(str(learn.__module__), place.split(".", 1)[0])
        whole = "\n".join((code, held, *self.features))
        return f"{self.name.replace(' ', '-')}-{hashlib.sha256(whole.encode()).hexdigest()[:12]}"


@dataclass(frozen=True, slots=True)
class Boosted:
    """The learner that grows boosted trees, one thread each: folds learn side by side.

    Attributes:
        parameters: How the trees are grown.
        relative: Whether each squared error is taken relative to the truth.
    """

    parameters: FitParameters
    relative: bool = False

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what the trees make of features."""
        weight = 1.0 / label_mu**2 if self.relative else None
        booster = grow_trees(features, label_mu, self.parameters, weight_ratio=weight, threads_count=1)
        return lambda rows: estimate_mu(booster, rows, threads_count=1)


def mends_first_guess(learn: Learner) -> bool:
    """Return whether a learner starts from its first feature, which then must be `FIRST_GUESS`."""
    return isinstance(learn, Boosted) and learn.parameters.base_column is not None


PAPER_RECIPE = Recipe("paper", PAPER_FEATURES, Boosted(PAPER_FIT))
"""The paper's regressor: 78 features, 100 trees of depth 6."""
SPEED_ONLY_RECIPE = replace(PAPER_RECIPE, name="speed only", features=SPEED_FEATURES)
"""The same from nothing but the speed: what the driver's caution alone gives away."""
BEST_RECIPE = Recipe(
    "best",
    (FIRST_GUESS, *(name for name in FEATURE_NAMES if name != FIRST_GUESS)),
    Boosted(
        FitParameters(
            trees_count=600,
            depth_count=7,
            learning_rate_ratio=0.05,
            row_share_frac=0.89,
            column_share_frac=0.75,
            node_column_share_frac=0.52,
            leaf_rows_count=9.5,
            target=Target.LOG_MU,
            base_column=0,
            certainty_power_ratio=1.7,
            bins_count=128,
        )
    ),
)
"""Everything the vehicle tells: many careful trees mend the best friction of the physical inverse.

The settings are those that `roadgrip-train study tune` found, but for fewer trees of a larger rate: half the work for a
hundredth of the error.
"""
