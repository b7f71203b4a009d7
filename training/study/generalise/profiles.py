"""What vehicles say together on a road nobody has learned: likelihoods that add up, against answers that do not.

A regressor draws doubtful passages towards what is usual, and fifty of them the same way. Likelihoods are not drawn:
those that the vehicles send, one value per friction; or the regressor's own answers, each divided by what was usual.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from roadgrip.features import PROFILE_FRICTIONS_MU
from roadgrip.units import FloatArray
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO
from rsu_app.domain.pooling import placement
from rsu_app.domain.profiles import ProfilePolicy, evidence_of_profiles, new_tyre_grid_mu
from rsu_app.domain.shrinkage import unshrunk
from training.dataset import Runs
from training.error_model import LEAST_MU
from training.regressor import RowIndices
from training.study.batches import (
    Cell,
    CellErrors,
    RowBatches,
    batches_of_cell,
    cells_of,
    errors_of_answers,
    mean_over_cells_ratio,
    published_rule,
    worst_cell,
)
from training.study.chapter import Arrays, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.chapter import Cell as TableCell
from training.study.folds import LEARNED_SETS, RANDOM_ROADS_SET, learner
from training.study.generalise.held_out import HeldOut, by_use, held_out, on_other_roads
from training.study.generalise.mean_features import learned_for_windows
from training.study.generalise.passages import Passages
from training.study.generalise.pooling import BEST, BOUNDED, CONFIGS, PAPER, Judged, judged_of, passages_of
from training.study.generalise.rules import (
    MEDIAN,
    POLICY,
    REFINED,
    RULES,
    WEIGHTED,
    interval_of,
    refined_or_nothing_mu,
    rule_on_rows,
)
from training.study.generalise.shrinkage import (
    evidence_of_estimates,
    learned_shrinkage,
    learned_temper_exponent,
    spread_ratio,
)
from training.study.generalise.uncertainty import recommended
from training.study.picture import Axis, Line, Lines
from training.study.recipes import Recipe
from training.study.wording import by_grade, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

BATCHES_SET = "random-roads-batches"
SIZES_COUNT = (10, 50)
BATCHES_COUNT = 120
QUICK_BATCHES_COUNT = 12
HELD_BATCHES_COUNT = 40
"""A share over all cells needs no more of each."""
CONFIDENCE_FRAC = 0.95
PROFILE_COLUMNS = tuple(f"grip_profile_{100 * mu:.0f}_ratio" for mu in PROFILE_FRICTIONS_MU)
GRID_MU: FloatArray = np.array(PROFILE_FRICTIONS_MU)

FLOOR = "median of perfect estimates"
PROFILES = "sum of the vehicles' likelihoods"
LIKELIHOOD = "sum of the regressor's likelihoods"
MIXTURE = "the vehicles' likelihood where sharper, else the regressor's"
MEAN_FEATURES = "regressor for mean features"
BOTH = "regressor's likelihoods and mean features"
CHOSEN = LIKELIHOOD
"""The estimator of the headline, chosen on other roads than those that judge it: it asks nothing new of a bundle but a
table of sixty numbers, and nothing of a unit but what its window holds."""
COMPARED = (MEDIAN, WEIGHTED, REFINED, PROFILES, LIKELIHOOD, MIXTURE, MEAN_FEATURES, BOTH)
NAMED = (MEDIAN, BOUNDED, CHOSEN)
"""What is compared where a unit names a friction at all; `BOUNDED` says where that is."""

_BIAS_WORST = ("mean bias", "worst 95th percentile")

BatchRule: TypeAlias = Callable[[RowBatches], FloatArray]
"""From the rows of batches to the midpoint for each."""
Errors: TypeAlias = dict[tuple[str, int], tuple[CellErrors, ...]]
"""Of every cell, by rule and number of vehicles."""
Named: TypeAlias = dict[tuple[str, int], Judged]
"""In short, by rule and number of vehicles, of the batches for which a unit names a friction."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What passages say of the friction of a new tyre, one line of logarithms each.

    Attributes:
        profile_values: By the likelihood they sent. (n, m)
        estimate_values: By what the regressor makes of them. (n, m)
        new_mu: The frictions. (m,)
    """

    profile_values: FloatArray
    estimate_values: FloatArray
    new_mu: FloatArray

    @property
    def sharper(self) -> FloatArray:
        """Of each passage the line that leaves less open. (n, m)"""
        by_profile, by_estimate = (
            spread_ratio(lines, new_mu=self.new_mu) for lines in (self.profile_values, self.estimate_values)
        )
        return np.where((by_profile < by_estimate)[:, None], self.profile_values, self.estimate_values)

    def summed(self, lines: FloatArray) -> BatchRule:
        """Return the rule that adds up lines of evidence; rows as in the table."""
        log_mu = np.log(self.new_mu)

        def midpoint_mu(batch: RowIndices) -> float:
            # One batch at a time: the lines of all of them would not fit into memory.
            placed = placement(lines[batch].sum(axis=0), log_mu=log_mu, confidence_frac=CONFIDENCE_FRAC)
            return MEDIAN_TYRE_RATIO * placed.mu_new

        return _one_by_one(midpoint_mu)


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Judge every way of combining vehicles on roads with many of them, by regressors that learned from other roads."""
    figures: dict[str, float] = {}
    tables: list[Table] = []
    pictures: list[Lines] = []
    judged = bench.runs(BATCHES_SET, grade)
    count = QUICK_BATCHES_COUNT if bench.quick else BATCHES_COUNT
    sizes = {"batches per cell": count, "seed": bench.seed}
    for config, recipe in CONFIGS.items():
        learned = held_out(bench, grade, recipe)
        there = on_other_roads(bench, grade, recipe, data_set=BATCHES_SET)
        temper_exponent = profile_temper_exponent(bench, grade, learned)
        rules = rules_on(bench, grade, recipe, learned, there, temper_exponent=temper_exponent)
        told = passages_of(there).with_bounds(recommended(learned))
        naming_rule = _one_by_one(rule_on_rows(refined_or_nothing_mu, told))
        cells = cells_of(judged.section_id, judged.labels["base_friction_mu"], rows=there.rows)
        sizes |= {"drives learned from": len(learned), "drives judged": len(there), "cells": len(cells)}
        found: Errors = {}
        named: Named = {}
        for size in SIZES_COUNT:
            bench.report(f"{size} vehicles on unseen roads, {recipe.name}, {grade}", 0, 1)
            batches = [batches_of_cell(cell, size_count=size, batches_count=count, seed=bench.seed) for cell in cells]
            rows = np.concatenate(batches)
            answers = {name: rule(rows) for name, rule in rules.items()}
            answers[BOTH] = np.sqrt(answers[LIKELIHOOD] * answers[MEAN_FEATURES])
            found |= {(name, size): errors_of_cells(cells, mu, size_count=size) for name, mu in answers.items()}
            answers[BOUNDED] = naming_rule(rows)
            for name in NAMED:
                mu = np.where(np.isfinite(answers[BOUNDED]), answers[name], np.nan)
                named[name, size] = judged_of(errors_of_cells(cells, mu, size_count=size))
        figures[f"{config}.temper_exponent"] = temper_exponent
        for size in SIZES_COUNT:
            figures[f"{config}.half_width.{size}.held_frac"] = half_width_held_frac(
                there, cells, size_count=size, batches_count=min(count, HELD_BATCHES_COUNT), seed=bench.seed
            )
            figures[f"{config}.bound.{size}.held_frac"] = bounds_held_frac(
                told, cells, size_count=size, batches_count=min(count, HELD_BATCHES_COUNT), seed=bench.seed
            )
        for (name, size), one in named.items():
            figures[f"{config}.named.{name}.{size}.answered_frac"] = one.answered_frac
            figures[f"{config}.named.{name}.{size}.mean"] = one.mean_ratio
            figures[f"{config}.named.{name}.{size}.worst_p95"] = one.worst.p95_ratio
        for (name, size), errors in found.items():
            figures |= {f"{config}.{name}.{size}.{what}": value for what, value in _in_short(errors).items()}
        figures[f"headline.{config}.interval50_worst_unseen"] = figures[f"{config}.{CHOSEN}.50.worst_p95"]
        named_50 = named[BOUNDED, 50]
        figures[f"headline.{config}.interval50_worst_unseen_named"] = named_50.worst.p95_ratio
        figures[f"headline.{config}.interval50_named_frac_unseen"] = named_50.answered_frac
        figures[f"headline.{config}.interval50_worst_unseen_median"] = figures[f"{config}.{MEDIAN}.50.worst_p95"]
        tables += [_table(recipe.name, found, size) for size in SIZES_COUNT]
        tables.append(_table_of_named(config, recipe.name, named, figures))
        tables.append(_table_by_use(recipe.name, found, use_ratio=_use_ratio(cells, judged)))
        pictures.append(_picture(recipe.name, found))
    return Result(figures=figures, sizes=sizes, tables=tuple(tables), pictures=tuple(pictures))


def profile_temper_exponent(bench: Workbench, grade: SensorGrade, learned: HeldOut) -> float:
    """Return how far the vehicles' likelihoods are to be believed, by the roads that were learned from."""

    def work() -> Arrays:
        exponent = learned_temper_exponent(
            learned.runs.columns(PROFILE_COLUMNS)[learned.rows],
            grid_mu=GRID_MU,
            base_friction_mu=learned.runs.labels["base_friction_mu"][learned.rows],
        )
        return {"exponent": np.array([exponent])}

    return float(bench.remembered(f"profile-temper-{RANDOM_ROADS_SET}-{grade}-{bench.seed}", work)["exponent"][0])


def rules_on(
    bench: Workbench,
    grade: SensorGrade,
    recipe: Recipe,
    learned: HeldOut,
    there: HeldOut,
    *,
    temper_exponent: float,
) -> dict[str, BatchRule]:
    """Return the rules that are compared, each for rows of the table of drives that are judged.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        recipe: The regressor's.
        learned: Drives on the roads learned from, each judged by regressors that had not seen its road.
        there: Drives on the roads that judge.
        temper_exponent: How far the vehicles' likelihoods are believed.
    """
    runs = there.runs
    shrinkage = learned_shrinkage(
        np.maximum(learned.mu, LEAST_MU),
        expected_error_ratio=learned.expected_error_ratio,
        label_mu=learned.label_mu,
    )
    mu = np.maximum(there.mu, LEAST_MU)
    estimates = unshrunk(mu, expected_error_ratio=there.expected_error_ratio, shrinkage=shrinkage)
    new_mu = new_tyre_grid_mu(GRID_MU)
    profiles = evidence_of_profiles(
        runs.columns(PROFILE_COLUMNS)[there.rows],
        grid_mu=GRID_MU,
        policy=ProfilePolicy(temper_exponent=temper_exponent),
    )
    by_estimate_values = evidence_of_estimates(estimates, new_mu=new_mu)
    evidence = Evidence(there.of_all_runs(profiles), there.of_all_runs(by_estimate_values), new_mu)
    passages = passages_of(there)
    return {
        FLOOR: _one_by_one(published_rule(runs.labels["label_mu"])),
        **{name: _one_by_one(rule_on_rows(RULES[name], passages)) for name in (MEDIAN, WEIGHTED, REFINED)},
        PROFILES: evidence.summed(evidence.profile_values),
        LIKELIHOOD: evidence.summed(evidence.estimate_values),
        MIXTURE: evidence.summed(evidence.sharper),
        MEAN_FEATURES: _mean_features_rule(bench, grade, recipe, learned, runs),
    }


def errors_of_cells(cells: tuple[Cell, ...], answers_mu: FloatArray, *, size_count: int) -> tuple[CellErrors, ...]:
    """Return how far answers are from the truth of each cell.

    Args:
        cells: Where the batches were drawn.
        answers_mu: Midpoints, those of a cell's batches after those of the cell before. (cells * batches,)
        size_count: Vehicles in a batch.
    """
    lines = answers_mu.reshape(len(cells), -1)
    return tuple(errors_of_answers(cell, line, size_count=size_count) for cell, line in zip(cells, lines, strict=True))


def half_width_held_frac(
    there: HeldOut, cells: tuple[Cell, ...], *, size_count: int, batches_count: int, seed: int
) -> float:
    """Return in which share of the batches the refined interval's half-width holds the truth; 95 % is what it says.

    Args:
        there: Drives on the roads that judge.
        cells: Of those.
        size_count: Vehicles in a batch.
        batches_count: Batches of each cell.
        seed: Of the draws.
    """
    passages = passages_of(there)
    held = []
    for cell in cells:
        for batch in batches_of_cell(cell, size_count=size_count, batches_count=batches_count, seed=seed):
            placed = interval_of(passages.rows(batch), policy=POLICY)
            held.append(abs(placed.mu_new - cell.base_friction_mu) <= placed.half_width_mu)
    return float(np.mean(held))


def bounds_held_frac(
    told: Passages, cells: tuple[Cell, ...], *, size_count: int, batches_count: int, seed: int
) -> float:
    """Return how often "at least" is true, where the unit says no more; NaN where it always names a friction.

    Args:
        told: What passages say, doubtful ones as bounds; one for every run.
        cells: Of the roads that judge.
        size_count: Vehicles in a batch.
        batches_count: Batches of each cell.
        seed: Of the draws.
    """
    held = []
    for cell in cells:
        for batch in batches_of_cell(cell, size_count=size_count, batches_count=batches_count, seed=seed):
            placed = interval_of(told.rows(batch), policy=POLICY)
            if placed.at_least:
                held.append(placed.mu_new <= cell.base_friction_mu)
    return float(np.mean(held)) if held else np.nan


def _one_by_one(rule: Callable[[RowIndices], float]) -> BatchRule:
    return lambda batches: np.array([rule(batch) for batch in batches], dtype=np.float64)


def _mean_features_rule(
    bench: Workbench, grade: SensorGrade, recipe: Recipe, learned: HeldOut, judged: Runs
) -> BatchRule:
    features = judged.columns(recipe.features)
    bench.report(f"regressor for mean features, {recipe.name}, {grade}", 0, 1)
    estimate_mu = learned_for_windows(
        learner(bench, recipe.learn),
        learned.runs.columns(recipe.features)[learned.rows],
        label_mu=learned.label_mu,
        roads=learned.roads,
    )

    def midpoints_mu(batches: RowBatches) -> FloatArray:
        return np.maximum(estimate_mu(np.array([features[batch].mean(axis=0) for batch in batches])), LEAST_MU)

    return midpoints_mu


def _in_short(errors: tuple[CellErrors, ...]) -> dict[str, float]:
    """Return what the errors of all cells come to, by the names of the figures and in the order of the table."""
    bias = np.abs([one.bias_ratio for one in errors])
    return {
        "mean": mean_over_cells_ratio(errors),
        "bias_mean": float(bias.mean()),
        "bias_worst": float(bias.max()),
        "p95_median": float(np.median([one.p95_ratio for one in errors])),
        "worst_p95": worst_cell(errors).p95_ratio,
    }


def _table(recipe_name: str, found: Errors, size: int) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for name in (FLOOR, *COMPARED):
        errors = found[name, size]
        worst = worst_cell(errors)
        where = f"{worst.road} at {worst.base_friction_mu:.2f}, {100.0 * worst.bias_ratio:+.0f}"
        rows.append((name, *(100.0 * figure for figure in _in_short(errors).values()), where))
    return Table(
        f"{size} vehicles on unseen random roads, {recipe_name} regressor, in per cent",
        ("rule", "mean error", "mean bias", "worst bias", "typical 95th percentile", "worst one", "there, bias"),
        tuple(rows),
        "Bias: mean signed error of the batches of one road and one base friction; its magnitude averaged over such "
        "cells, and the largest. 95th percentile of the magnitude over batches: median over cells, and the worst.",
    )


def _table_of_named(config: str, recipe_name: str, named: Named, figures: Mapping[str, float]) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for (name, size), one in named.items():
        held = figures[f"{config}.bound.{size}.held_frac"]
        where = f"{one.worst.road} at {one.worst.base_friction_mu:.2f}, {100.0 * one.worst.bias_ratio:+.0f}"
        rows.append(
            (
                size,
                name,
                100.0 * one.answered_frac,
                100.0 * one.mean_ratio,
                100.0 * one.worst.p95_ratio,
                where,
                None if np.isnan(held) else 100.0 * held,
            )
        )
    return Table(
        f"Batches on unseen random roads for which a unit names a friction, {recipe_name} regressor, in per cent",
        ("vehicles", "rule", "named", "mean error", "worst 95th percentile", "there, bias", "else the bound holds"),
        tuple(rows),
        "Doubtful estimates count as bounds, as a bundle has it; where too few others are left, the unit only says "
        '"at least". All rules are judged on the batches for which it says more.',
    )


def _use_ratio(cells: tuple[Cell, ...], runs: Runs) -> FloatArray:
    """Return which share of the grip the middle vehicle of each cell used at most. (cells,)"""
    peak = runs.labels["peak_utilisation_ratio"]
    return np.array([float(np.median(peak[cell.rows])) for cell in cells])


def _table_by_use(recipe_name: str, found: Errors, *, use_ratio: FloatArray) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for band, chosen in by_use(use_ratio).items():
        if chosen.any():
            cells: list[TableCell] = [band, int(chosen.sum())]
            for name in (MEDIAN, CHOSEN):
                errors = [found[name, 50][i] for i in np.flatnonzero(chosen).tolist()]
                cells += [
                    100.0 * float(np.mean([abs(one.bias_ratio) for one in errors])),
                    100.0 * worst_cell(errors).p95_ratio,
                ]
            rows.append(tuple(cells))
    columns = (
        "share of the grip used",
        "cells",
        *(f"{what}, {by}" for by in ("median", CHOSEN) for what in _BIAS_WORST),
    )
    return Table(
        f"Fifty vehicles on unseen random roads by the grip they use, {recipe_name} regressor, in per cent",
        columns,
        tuple(rows),
        "The largest share of the grip that the middle vehicle of a cell used.",
    )


def _picture(recipe_name: str, found: Errors) -> Lines:
    lines = []
    for name in (FLOOR, *COMPARED):
        by_friction: dict[float, list[float]] = {}
        for one in found[name, 50]:
            by_friction.setdefault(one.base_friction_mu, []).append(abs(one.bias_ratio))
        x = tuple(sorted(by_friction))
        y = tuple(100.0 * float(np.mean(by_friction[friction])) for friction in x)
        lines.append(Line(name, x, y, dashed=name == FLOOR))
    return Lines(
        f"Bias of fifty vehicles on unseen roads, {recipe_name} regressor",
        Axis("base friction"),
        Axis("magnitude of the bias, mean over roads, per cent", low=0.0),
        tuple(lines),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say what adding up likelihoods wins over adding up answers, and what is left."""

    def told(config: str, rule: str, what: str) -> str:
        return by_grade(results, f"{config}.{rule}.50.{what}")

    def least(grade: SensorGrade) -> str:
        worst = {rule: results[grade].figures[f"{BEST}.{rule}.50.worst_p95"] for rule in COMPARED}
        rule = min(COMPARED, key=lambda name: worst[name])
        return f"{per_cent_words(worst[rule])} ({grade}, {rule})"

    text = (
        "Fifty vehicles on roads never seen, best regressor: the middle of the interval is off by "
        f"{told(BEST, MEDIAN, 'bias_mean')} by the median in the mean over roads and frictions, by "
        f"{told(BEST, REFINED, 'bias_mean')} refined, and by {told(BEST, CHOSEN, 'bias_mean')} if the regressor's "
        "likelihoods are added up; by those that the vehicles send, without any regressor, by "
        f"{told(BEST, PROFILES, 'bias_mean')}. The paper's configuration comes to "
        f"{told(PAPER, MEDIAN, 'bias_mean')} by the median. In the worst cell of road and friction 95 % of the batches "
        f"are within {told(BEST, MEDIAN, 'worst_p95')} by the median and {told(BEST, CHOSEN, 'worst_p95')} by the "
        f"regressor's likelihoods; the least of all rules is {', '.join(least(grade) for grade in results)}. What is "
        "left is what all vehicles on one road share, most of all where none of them needs much grip: no number of "
        f"them averages it out. {_where_named(results, BEST)} The refined interval's half-width, which says "
        f"95 %, holds the truth in {told(BEST, 'half_width', 'held_frac')} of the batches."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


def _where_named(results: Mapping[SensorGrade, Result], config: str) -> str:
    """Return how far off the batches are for which a unit names a friction, and how often it is right elsewhere."""
    named = f"{config}.named.{BOUNDED}.50"
    answered = {grade: result for grade, result in results.items() if result.figures[f"{named}.answered_frac"] > 0.0}
    bounded = {grade: result for grade, result in results.items() if np.isfinite(result.figures[_held(config)])}
    text = "A unit that takes doubtful estimates for bounds "
    if answered:
        text += (
            f"names a friction in {by_grade(answered, f'{named}.answered_frac')} of the batches, and is then off by "
            f"{by_grade(answered, f'{named}.mean')} in the mean, {by_grade(answered, f'{named}.worst_p95')} in the "
            "worst cell"
        )
    else:
        text += "names no friction"
    return text + (
        f'; elsewhere it says "at least", rightly in {by_grade(bounded, _held(config))}.' if bounded else "."
    )


def _held(config: str) -> str:
    return f"{config}.bound.50.held_frac"


CHAPTER = Chapter(
    name="profiles",
    title="Likelihoods that add up: many vehicles on a road nobody has learned",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=(*LEARNED_SETS, BATCHES_SET),
)
