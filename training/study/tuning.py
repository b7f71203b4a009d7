"""The search for the best regressor's settings: how its trees are grown, judged on roads they had not seen.

A fixed share of the random roads is searched on, by folds of roads. What was found is then held against what the search
began with on the other roads, of which the search knows nothing: the best of many is always flattered by the roads
that chose it. The search keeps a journal, so that one that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import mape_ratio
from training.dataset import DatasetError, Runs
from training.fit_parameters import Target
from training.regressor import RowIndices
from training.study.folds import estimates_by_strangers, fold_numbers, roads_of, rows_by_name
from training.study.recipes import Boosted, Recipe
from vehicle_client.simulator.plan import SensorGrade

if TYPE_CHECKING:
    from optuna.trial import Trial

SPACE_VERSION = 2
"""Counts up when what is searched changes: a journal of another space is not gone on with."""
FOLDS_COUNT = 4
ROADS_FRAC = 0.5
"""Share of the roads that is searched on, at most."""
MOST_TREES_COUNT = 1500
"""A model of more trees than this is no longer small."""
RATE_RANGE, EFFORT_RANGE = (0.01, 0.3), (5.0, 80.0)
DEPTH_RANGE, ROW_RANGE, COLUMN_RANGE = (3, 8), (0.3, 1.0), (0.1, 1.0)
LEAF_RANGE, POWER_RANGE = (1.0, 30.0), (0.0, 2.5)
"""What is searched; effort is the sum of the trees' learning rates."""
START, FOUND = "start", "found"


@dataclass(frozen=True, slots=True)
class Grounds:
    """What a search with one grade of sensors goes by.

    Attributes:
        features: Of the roads searched on. (n, columns)
        label_mu: (n,)
        fold: All rows of a road in the same. (n,)
        other_features: Of the other roads. (m, columns)
        other_label_mu: (m,)
        roads_count: Roads searched on.
        other_roads_count: Other roads.
        digest: Of the runs.
    """

    features: FloatArray
    label_mu: FloatArray
    fold: RowIndices
    other_features: FloatArray
    other_label_mu: FloatArray
    roads_count: int
    other_roads_count: int
    digest: str


@dataclass(frozen=True, slots=True)
class Tuned:
    """What a search came to.

    Attributes:
        learn: How the best regressor found learns.
        searched_mape_ratio: MAPE on the roads searched on by grade, of what the search began with and of what it found.
        other_mape_ratio: The same on the other roads, after learning from those searched on.
        trials_count: Settings tried in all.
        improved: Whether what was found is better on the other roads, too.
    """

    learn: Boosted
    searched_mape_ratio: Mapping[SensorGrade, tuple[float, float]]
    other_mape_ratio: Mapping[SensorGrade, tuple[float, float]]
    trials_count: int

    @property
    def improved(self) -> bool:
        """Whether the settings found are better on roads that the search did not know; all grades weigh the same."""
        return _score([found / start for start, found in self.other_mape_ratio.values()]) < 1.0


def grounds_of(runs: Runs, features: tuple[str, ...], *, roads_count: int, seed: int) -> Grounds:
    """Return what a search goes by.

    Args:
        runs: Of many roads.
        features: Names of what is learned from.
        roads_count: Roads to search on; half of all there are at most.
        seed: Chooses them and deals them to folds.

    Raises:
        DatasetError: There are too few roads.
    """
    rows = rows_by_name(runs)
    names, road = np.unique(roads_of(runs, rows), return_inverse=True)
    count = min(roads_count, int(ROADS_FRAC * len(names)))
    if count < FOLDS_COUNT:
        raise DatasetError(f"{len(names)} roads are too few to search on some and be judged on others")
    chosen = np.random.default_rng([seed, len(names)]).permutation(len(names))[:count]
    fold_of = np.full(len(names), -1)
    fold_of[chosen] = fold_numbers(count, FOLDS_COUNT, seed=seed)
    fold, inside = fold_of[road], np.isin(road, chosen)
    columns, label = runs.columns(features)[rows], runs.labels["label_mu"][rows]
    return Grounds(
        features=columns[inside],
        label_mu=label[inside],
        fold=fold[inside],
        other_features=columns[~inside],
        other_label_mu=label[~inside],
        roads_count=count,
        other_roads_count=len(names) - count,
        digest=runs.digest(),
    )


def tune(
    recipe: Recipe,
    grounds: Mapping[SensorGrade, Grounds],
    journal: Path,
    *,
    trials_count: int,
    limit_s: float | None = None,
    seed: int,
    on_trial: Callable[[int, float], None] | None = None,
) -> Tuned:
    """Return the settings with the least error on roads not seen, one for all grades of sensors.

    Args:
        recipe: What the search begins with; its learner must be `Boosted`, its features those of the grounds.
        grounds: What it goes by, by grade.
        journal: File that keeps every trial; what is there is gone on with if it is of the same grounds and recipe.
        trials_count: Settings to try in all, those in the journal included.
        limit_s: Begin no further trial after this time, the very first apart.
        seed: Of the search.
        on_trial: Called after each trial with the number of those done and the least score so far: the geometric mean
            over grades of the MAPE.

    References:
        Bergstra, Bardenet, Bengio, Kegl, Algorithms for hyper-parameter optimization, 2011 (the sampler).
    """
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend
    from optuna.trial import FrozenTrial, TrialState

    start = _boosted(recipe)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    journal.parent.mkdir(parents=True, exist_ok=True)
    name = _study_name(recipe, grounds, seed=seed)
    storage = JournalStorage(JournalFileBackend(str(journal)))

    def finished() -> list[FrozenTrial]:
        return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))

    # A sampler begins anew with each process: without the number of trials it would propose the same again.
    study = optuna.create_study(storage=storage, study_name=name, direction="minimize", load_if_exists=True)
    study.sampler = optuna.samplers.TPESampler(seed=seed + len(study.trials))
    if not study.trials:
        study.enqueue_trial(_suggestion_of(start))

    def judge(trial: Trial) -> float:
        learn = _suggested(trial, start)
        return _score([_searched(one, replace(recipe, learn=learn)) for one in grounds.values()])

    def tell(_study: object, _trial: object) -> None:
        if on_trial is not None:
            on_trial(len(finished()), study.best_value)

    if not finished():
        study.optimize(judge, n_trials=1, callbacks=[tell])
    if (missing := trials_count - len(finished())) > 0:
        study.optimize(judge, n_trials=missing, timeout=limit_s, callbacks=[tell])
    found = _boosted_of(study.best_params, start)
    pairs = [(START, replace(recipe, learn=start)), (FOUND, replace(recipe, learn=found))]
    return Tuned(
        learn=found,
        searched_mape_ratio={g: _pair([_searched(one, both) for _, both in pairs]) for g, one in grounds.items()},
        other_mape_ratio={g: _pair([_other(one, both) for _, both in pairs]) for g, one in grounds.items()},
        trials_count=len(finished()),
    )


def document_of(tuned: Tuned, grounds: Mapping[SensorGrade, Grounds], *, seed: int) -> dict[str, Any]:
    """Return what a search came to, as it is committed."""

    def by_grade(found: Mapping[SensorGrade, tuple[float, float]]) -> dict[str, dict[str, float]]:
        return {grade.value: {START: round(a, 6), FOUND: round(b, 6)} for grade, (a, b) in found.items()}

    return {
        "parameters": asdict(tuned.learn.parameters),
        "relative": tuned.learn.relative,
        "trials_count": tuned.trials_count,
        "folds_count": FOLDS_COUNT,
        "seed": seed,
        "mape_ratio_on_roads_searched_on": by_grade(tuned.searched_mape_ratio),
        "mape_ratio_on_other_roads": by_grade(tuned.other_mape_ratio),
        "improved": tuned.improved,
        "grounds": {
            grade.value: {
                "roads_count": one.roads_count,
                "other_roads_count": one.other_roads_count,
                "data_digest": one.digest,
            }
            for grade, one in grounds.items()
        },
    }


def _boosted(recipe: Recipe) -> Boosted:
    if not isinstance(recipe.learn, Boosted):
        raise TypeError(f"{recipe.name} does not learn by boosted trees alone")
    return recipe.learn


def _suggested(trial: Trial, start: Boosted) -> Boosted:
    rate = trial.suggest_float("learning_rate_ratio", *RATE_RANGE, log=True)
    effort = trial.suggest_float("effort_ratio", *EFFORT_RANGE, log=True)
    values: dict[str, Any] = {
        "learning_rate_ratio": rate,
        "effort_ratio": effort,
        "depth_count": trial.suggest_int("depth_count", *DEPTH_RANGE),
        "row_share_frac": trial.suggest_float("row_share_frac", *ROW_RANGE),
        "column_share_frac": trial.suggest_float("column_share_frac", *COLUMN_RANGE),
        "node_column_share_frac": trial.suggest_float("node_column_share_frac", *COLUMN_RANGE),
        "leaf_rows_count": trial.suggest_float("leaf_rows_count", *LEAF_RANGE, log=True),
        "certainty_power_ratio": trial.suggest_float("certainty_power_ratio", *POWER_RANGE),
        "aim": trial.suggest_categorical("aim", ["log", "relative"]),
    }
    return _boosted_of(values, start)


def _boosted_of(values: Mapping[str, Any], start: Boosted) -> Boosted:
    """Return the learner of a trial; what is not searched is as in the beginning.

    The number of trees goes by the sum of their learning rates: fewer trees of a larger rate go as far.
    """
    trees = round(values["effort_ratio"] / values["learning_rate_ratio"])
    parameters = replace(
        start.parameters,
        trees_count=max(1, min(trees, MOST_TREES_COUNT)),
        learning_rate_ratio=float(f"{values['learning_rate_ratio']:.3g}"),
        depth_count=int(values["depth_count"]),
        row_share_frac=round(float(values["row_share_frac"]), 3),
        column_share_frac=round(float(values["column_share_frac"]), 3),
        node_column_share_frac=round(float(values["node_column_share_frac"]), 3),
        leaf_rows_count=round(float(values["leaf_rows_count"]), 1),
        certainty_power_ratio=round(float(values["certainty_power_ratio"]), 2),
        target=Target.LOG_MU if values["aim"] == "log" else Target.MU,
        # Only a logarithm is told as a distance from a first guess.
        base_column=start.parameters.base_column if values["aim"] == "log" else None,
    )
    return Boosted(parameters, relative=values["aim"] == "relative")


def _suggestion_of(start: Boosted) -> dict[str, Any]:
    """Return the trial that tries what the search begins with, or what comes nearest to it."""
    given = start.parameters
    effort_ratio = given.trees_count * given.learning_rate_ratio
    return {
        "learning_rate_ratio": _within(given.learning_rate_ratio, RATE_RANGE),
        "effort_ratio": _within(effort_ratio, EFFORT_RANGE),
        "depth_count": int(_within(given.depth_count, DEPTH_RANGE)),
        "row_share_frac": _within(given.row_share_frac, ROW_RANGE),
        "column_share_frac": _within(given.column_share_frac, COLUMN_RANGE),
        "node_column_share_frac": _within(given.node_column_share_frac, COLUMN_RANGE),
        "leaf_rows_count": _within(given.leaf_rows_count, LEAF_RANGE),
        "certainty_power_ratio": _within(given.certainty_power_ratio, POWER_RANGE),
        "aim": "log" if given.target is Target.LOG_MU else "relative",
    }


def _within(value: float, ends: tuple[float, float]) -> float:
    return min(max(value, ends[0]), ends[1])


def _searched(grounds: Grounds, recipe: Recipe) -> float:
    mu = estimates_by_strangers(recipe.learn, grounds.features, grounds.label_mu, fold=grounds.fold)
    return mape_ratio(grounds.label_mu, mu)


def _other(grounds: Grounds, recipe: Recipe) -> float:
    mu = recipe.learn(grounds.features, grounds.label_mu)(grounds.other_features)
    return mape_ratio(grounds.other_label_mu, mu)


def _score(mape_of_grade_ratio: list[float]) -> float:
    """Return the geometric mean: a tenth less error counts the same with any sensors."""
    return float(np.exp(np.mean(np.log(mape_of_grade_ratio))))


def _pair(values: list[float]) -> tuple[float, float]:
    first, second = values
    return first, second


def _study_name(recipe: Recipe, grounds: Mapping[SensorGrade, Grounds], *, seed: int) -> str:
    parts = [f"{grade.value} {one.digest} {one.roads_count}" for grade, one in grounds.items()]
    whole = "\n".join((recipe.key, str(SPACE_VERSION), str(seed), *parts))
    return f"recipe-{hashlib.sha256(whole.encode()).hexdigest()[:12]}"
