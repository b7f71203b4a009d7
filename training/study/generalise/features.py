"""What each group of features is worth on roads never seen, and how few of them are nearly as good as all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from roadgrip.features import FEATURE_NAMES, NEWEST_TABLE
from roadgrip.units import BoolArray, FloatArray
from training.fit_parameters import FitParameters, Target
from training.regressor import RowIndices, grow_trees
from training.study.chapter import Arrays, Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.folds import RANDOM_ROADS_SET, estimates_by_strangers, learner, road_folds, roads_of, rows_by_name
from training.study.generalise.held_out import HIGH_UTILISATION_RATIO, by_use, mean_by_road
from training.study.paper_features import PAPER_FEATURES
from training.study.picture import Axis, Bars
from training.study.recipes import BEST_RECIPE, FIRST_GUESS, Estimator, Learner, Recipe, mends_first_guess
from training.study.wording import by_grade, leading_grade, listed
from vehicle_client.simulator.plan import SensorGrade

JUDGED_FOLDS_COUNT = 4
"""Half as many as elsewhere: what matters here are differences, and there are many groups."""
PRIOR_FEATURES = (
    "speed_mean_mps",
    "speed_min_mps",
    "speed_max_mps",
    "curvature_min_1pm",
    "curvature_max_1pm",
    "section_length_m",
    "force_y_max_mps2",
)
"""What anybody beside the road might guess from: how fast, how tight, how hard."""
ALL_CHANNELS = "all channels"
CHANNELS: Mapping[str, str] = {
    "steering": "grip_steering_",
    "drift": "grip_drift_",
    "wheels": "grip_wheels_",
    ALL_CHANNELS: "grip_all_",
}
SHIFT = "shift_ratio"
"""How far the best friction of a channel lies from that of all channels together."""
INVERSE_PREFIX, PROFILE_PREFIX = "grip_", "grip_profile_"
OVER_INVERSE_SUFFIX = "_use_ratio"
"""Shares of the friction that the inverse finds likeliest: they tell of it, too."""
PRIOR, PAPER, ALL = "prior only", "the paper's", "everything"
SHAPES, PROFILE = "the paper's and all shapes", "the paper's and the profile"
INVERSE, NO_INVERSE = "prior and the inverse", "everything but the inverse"
FEWER_COUNTS = (40, 20)
RANKING_FIT = FitParameters(
    trees_count=200,
    depth_count=5,
    learning_rate_ratio=0.1,
    row_share_frac=0.7,
    column_share_frac=0.4,
    target=Target.LOG_MU,
    bins_count=64,
)
"""Finds which features matter; not what they are judged by."""
NAMED_COUNT = 20


@dataclass(frozen=True, slots=True)
class BestByGain:
    """The learner that first finds which columns matter to it, and learns from those alone.

    It finds them in what it is given to learn from: roads that it is judged on have no say in it.

    Attributes:
        learn: How to learn from the columns that were found.
        count: How many columns.
    """

    learn: Learner
    count: int

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what is made of features, of which most are not looked at."""
        chosen = columns_by_gain(features, label_mu)
        if mends_first_guess(self.learn):
            chosen = np.concatenate([[0], chosen[chosen != 0]])
        chosen = chosen[: self.count]
        estimator = self.learn(features[:, chosen], label_mu)
        return lambda rows: estimator(rows[:, chosen])


@dataclass(frozen=True, slots=True)
class OneChannel:
    """The learner that knows of a channel's own best friction, and nothing of that of all channels together.

    The feature table tells a channel's best by how far it lies from that of all, which alone would mean nothing.

    Attributes:
        learn: How to learn from the channel's best, in place of the first two columns, and the others.
    """

    learn: Learner

    def __call__(self, features: FloatArray, label_mu: FloatArray) -> Estimator:
        """Return what is made of features: the best of all channels, the channel's shift from it, then any others."""
        estimator = self.learn(_own_best(features), label_mu)
        return lambda rows: estimator(_own_best(rows))


def _own_best(features: FloatArray) -> FloatArray:
    best_mu: FloatArray = features[:, 0] * np.exp(features[:, 1])
    return np.column_stack([best_mu, features[:, 2:]])


def columns_by_gain(features: FloatArray, label_mu: FloatArray) -> RowIndices:
    """Return the columns by what trees gain from them in all, most first. (columns,)

    Args:
        features: (n, columns)
        label_mu: The truth. (n,)
    """
    trees = grow_trees(features, label_mu, RANKING_FIT, threads_count=1)
    gained = trees.get_score(importance_type="total_gain")
    gain = np.array([gained.get(f"f{i}", 0.0) for i in range(features.shape[1])])
    return np.argsort(-gain, kind="stable")


def groups(names: Sequence[str] = FEATURE_NAMES) -> dict[str, tuple[str, ...]]:
    """Return the groups of features that are judged, by name, each in the order of the table.

    Args:
        names: All there are, those of the paper's table among them.
    """

    def among(wanted: Sequence[str]) -> tuple[str, ...]:
        return tuple(name for name in names if name in set(wanted))

    inverse = [name for name in names if name.startswith(INVERSE_PREFIX) or name.endswith(OVER_INVERSE_SUFFIX)]
    profile = [name for name in inverse if name.startswith(PROFILE_PREFIX)]
    shapes = [name for name in inverse if name.startswith(tuple(CHANNELS.values()))]
    return {
        PRIOR: among(PRIOR_FEATURES),
        PAPER: among(PAPER_FEATURES),
        NO_INVERSE: among([name for name in names if name not in inverse]),
        **{
            f"{PAPER} and {channel}": among([*PAPER_FEATURES, *(name for name in shapes if name.startswith(prefix))])
            for channel, prefix in CHANNELS.items()
        },
        SHAPES: among([*PAPER_FEATURES, *shapes]),
        PROFILE: among([*PAPER_FEATURES, *profile]),
        INVERSE: among([*PRIOR_FEATURES, *inverse]),
        ALL: tuple(names),
    }


def recipes() -> dict[str, Recipe]:
    """Return how each group is judged: all alike, by the way of learning of the best regressor."""
    found = {name: BEST_RECIPE.on(some, name=name) for name, some in groups().items()}
    for channel, prefix in CHANNELS.items():
        if channel != ALL_CHANNELS:
            name, shift = f"{PAPER} and {channel}", f"{prefix}{SHIFT}"
            rest = (feature for feature in found[name].features if feature != shift)
            found[name] = Recipe(name, (FIRST_GUESS, shift, *rest), OneChannel(BEST_RECIPE.learn))
    for count in FEWER_COUNTS:
        name = fewer_name(count)
        found[name] = Recipe(name, BEST_RECIPE.on(FEATURE_NAMES).features, BestByGain(BEST_RECIPE.learn, count))
    return found


def fewer_name(count: int) -> str:
    """Return the name of the group of so many best features."""
    return f"the best {count}"


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Judge every group on held-out roads."""
    runs = bench.runs(RANDOM_ROADS_SET, grade)
    rows = rows_by_name(runs)
    label, used = runs.labels["label_mu"][rows], runs.labels["peak_utilisation_ratio"][rows]
    roads = roads_of(runs, rows)
    judged = recipes()
    error: dict[str, FloatArray] = {}
    for done, (name, recipe) in enumerate(judged.items()):
        bench.report(f"groups of features, {grade}", done, len(judged))
        error[name] = np.abs(_estimates(bench, grade, recipe) / label - 1.0)
    spread = {name: mean_by_road(values - error[ALL], roads) for name, values in error.items()}
    standard = {name: float(values.std(ddof=1) / np.sqrt(len(values))) for name, values in spread.items()}
    mape = {name: float(values.mean()) for name, values in error.items()}
    ranked = _ranked(bench, grade)
    figures = {f"mape.{name}": value for name, value in mape.items()}
    figures |= {f"standard_error.{name}": value for name, value in standard.items()}
    figures |= {
        f"mape_util60.{name}": float(values[used >= HIGH_UTILISATION_RATIO].mean())
        for name, values in error.items()
        if (used >= HIGH_UTILISATION_RATIO).any()
    }
    figures |= {f"place.{name}": float(place) for place, name in enumerate(ranked[:NAMED_COUNT], start=1)}
    return Result(
        figures=figures,
        sizes={
            "passages": len(rows),
            "roads": len(set(roads)),
            "folds, by road": JUDGED_FOLDS_COUNT,
            "features in all": len(FEATURE_NAMES),
            "seed": bench.seed,
        },
        tables=(_group_table(judged, error, standard, by_use(used)), _ranked_table(ranked)),
        pictures=(
            Bars(
                f"MAPE on roads never seen by group of features, {grade} sensors",
                "features",
                Axis("MAPE in %", low=0.0),
                tuple(judged),
                (("all passages", tuple(per_cent(mape[name]) for name in judged)),),
            ),
        ),
    )


def _group_table(
    judged: Mapping[str, Recipe],
    error: Mapping[str, FloatArray],
    standard: Mapping[str, float],
    bands: Mapping[str, BoolArray],
) -> Table:
    """Return the errors of all groups.

    Args:
        judged: How each group was judged.
        error: Magnitude of the error of each passage, relative to the truth, by group. Each (m,)
        standard: Standard error of a group's difference from everything.
        bands: Which passages used how much of the grip. Each (m,)
    """
    everything = float(error[ALL].mean())
    return Table(
        "MAPE on roads never seen by group of features, in %",
        ("features", "floats", "of them sent", "MAPE", "more than everything", "+-", *bands),
        tuple(
            (
                name,
                *floats_counts(recipe),
                per_cent(float(error[name].mean())),
                per_cent(float(error[name].mean()) - everything),
                per_cent(standard[name]),
                *(per_cent(error[name][chosen].mean()) if chosen.any() else None for chosen in bands.values()),
            )
            for name, recipe in judged.items()
        ),
        note="All learned in the same way, that of the best regressor. What the map says is not sent. The last "
        "columns: by the largest share of the grip used. +-: one standard error of the difference, over roads. "
        f"The best {listed([str(count) for count in FEWER_COUNTS])} are found by gain, in each fold anew, on the roads "
        "that are learned from.",
    )


def _ranked_table(ranked: Sequence[str]) -> Table:
    return Table(
        f"The {NAMED_COUNT} features that trees gain most from",
        ("place", "feature"),
        tuple(enumerate(ranked[:NAMED_COUNT], start=1)),
        note="By total gain, on all random roads. Features that say nearly the same share their gain.",
    )


def floats_counts(recipe: Recipe) -> tuple[Cell, Cell]:
    """Return how many figures a group needs, and how many of them the vehicle has to send."""
    if isinstance(recipe.learn, BestByGain):
        return recipe.learn.count, None
    # A channel's own best friction is one figure, which the table tells as two.
    names = recipe.features[1:] if isinstance(recipe.learn, OneChannel) else recipe.features
    sent = {feature.name for feature in NEWEST_TABLE.kinematic}
    return len(names), sum(feature in sent for feature in names)


def _estimates(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> FloatArray:
    """Return the estimate of every passage by strangers to its road, passages by name. (m,)"""

    def work() -> Arrays:
        runs = bench.runs(RANDOM_ROADS_SET, grade)
        rows = rows_by_name(runs)
        fold = road_folds(roads_of(runs, rows), seed=bench.seed) % JUDGED_FOLDS_COUNT
        features, label = runs.columns(recipe.features)[rows], runs.labels["label_mu"][rows]
        return {"mu": estimates_by_strangers(learner(bench, recipe.learn), features, label, fold=fold)}

    return bench.remembered(f"features-{grade}-{recipe.key}-{bench.seed}", work)["mu"]


def _ranked(bench: Workbench, grade: SensorGrade) -> tuple[str, ...]:
    def work() -> Arrays:
        runs = bench.runs(RANDOM_ROADS_SET, grade)
        rows = rows_by_name(runs)
        order = columns_by_gain(runs.columns(FEATURE_NAMES)[rows], runs.labels["label_mu"][rows])
        return {"order": order.astype(np.float64)}

    order = bench.remembered(f"features-by-gain-{grade}", work)["order"].astype(np.intp)
    return tuple(FEATURE_NAMES[i] for i in order.tolist())


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say what carries the friction from road to road."""
    grade = leading_grade(results)
    mape = {
        name.removeprefix("mape."): value for name, value in results[grade].figures.items() if name.startswith("mape.")
    }
    channels = {name: mape[f"{PAPER} and {name}"] for name in CHANNELS if name != ALL_CHANNELS}
    best_channel = min(channels, key=lambda name: channels[name])
    inverse_wins = mape[ALL] < 0.9 * mape[NO_INVERSE]
    few = min((count for count in FEWER_COUNTS if mape[fewer_name(count)] <= 1.1 * mape[ALL]), default=None)
    told = fewer_name(few or max(FEWER_COUNTS))
    fewest = f"With {told} alone it is {by_grade(results, f'mape.{told}')}, " + (
        "at most a tenth more." if few else "more than a tenth more."
    )
    text = (
        f"Learned in the same way, the paper's features err by {by_grade(results, f'mape.{PAPER}')} on roads never "
        f"seen; speed, curvature and peak force, which hold no more than a guess, by "
        f"{by_grade(results, f'mape.{PRIOR}')}; everything by {by_grade(results, f'mape.{ALL}')}. What the physical "
        f"inverse adds on board is {'what makes the difference' if inverse_wins else 'little'}: without it everything "
        f"else errs by {by_grade(results, f'mape.{NO_INVERSE}')}, and with the prior alone beside it, it errs by "
        f"{by_grade(results, f'mape.{INVERSE}')}. Of its channels {best_channel} alone helps the paper's features "
        f"most with {grade} sensors, to {by_grade(results, f'mape.{PAPER} and {best_channel}')}. {fewest}"
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="features",
    title="What each group of features is worth on roads never seen",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=(RANDOM_ROADS_SET,),
)
