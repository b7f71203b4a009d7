"""Error of the friction interval against the number of vehicles: the published median, and what knows more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from roadgrip.bundle import Conformal
from training.error_model import LEAST_MU
from training.regressor import RowIndices
from training.study.batches import (
    CellErrors,
    Rule,
    answers_of_cell,
    cells_of,
    errors_of_answers,
    mean_over_cells_ratio,
    published_rule,
    worst_cell,
)
from training.study.chapter import Arrays, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.chapter import Cell as TableCell
from training.study.folds import LEARNED_SETS, PAPER_SET
from training.study.generalise.held_out import HeldOut, held_out, on_known_roads, on_other_roads
from training.study.generalise.passages import Passages, Traffic, drawn_passages
from training.study.generalise.rules import (
    KAPLAN_MEIER,
    LOOSE,
    MEDIAN,
    POLICY,
    POSTERIOR,
    REFINED,
    RULES,
    WEIGHTED,
    interval_of,
    refined_or_nothing_mu,
    relative_errors,
    rule_on_rows,
)
from training.study.generalise.uncertainty import recommended
from training.study.picture import Axis, Line, Lines, Picture
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, Recipe
from training.study.wording import by_grade, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

MU_NEW = 0.5
SIMULATED_SIZES_COUNT = (1, 2, 5, 10, 20, 50, 100)
DRIVEN_SIZES_COUNT = (1, 5, 10, 20, 50, 100)
WINDOWS_COUNT = 2000
QUICK_WINDOWS_COUNT = 60
BATCHES_COUNT = 300
QUICK_BATCHES_COUNT = 12
PAPER, BEST = "paper_config", "best"
CONFIGS: Mapping[str, Recipe] = {PAPER: PAPER_RECIPE, BEST: BEST_RECIPE}
"""The regressors whose estimates are pooled, by the name the study's headlines give them."""

KINDS_OF_TRAFFIC: Mapping[str, Traffic] = {
    "known errors": Traffic(),
    "three in ten need little grip": Traffic(shy_frac=0.3),
    "six in ten need little grip": Traffic(shy_frac=0.6),
    "all share an error of 3 %": Traffic(road_bias_ratio=0.03),
}
FLOOR = "median of perfect estimates"
BOUNDED_MEDIAN = "Kaplan-Meier median, doubtful as bounds"
BOUNDED = "posterior within 2 %, doubtful as bounds"
MEDIAN_THERE = "median, where that one answers"
"""What is won by saying nothing where nothing can be known, apart from what is won by the rule."""
JUDGED = (MEDIAN, WEIGHTED, POSTERIOR, LOOSE, REFINED)
"""Rules that answer for every batch; compared with each other."""


@dataclass(frozen=True, slots=True)
class Judged:
    """How a rule did on driven data with batches of one size.

    Attributes:
        mean_ratio: Mean magnitude of the error, over batches and then over cells.
        worst: The cell with the largest 95th percentile; of those where the rule answers, if it does anywhere.
        answered_frac: Share of the batches that the rule answered.
    """

    mean_ratio: float
    worst: CellErrors
    answered_frac: float


def judged_of(errors: tuple[CellErrors, ...]) -> Judged:
    """Return the errors of all cells in short, at least one; what a rule does not answer is no error."""
    answered = [one for one in errors if one.answered_frac > 0.0]
    return Judged(
        mean_ratio=mean_over_cells_ratio(answered) if answered else np.nan,
        worst=worst_cell(answered or errors),
        answered_frac=float(np.mean([one.answered_frac for one in errors])),
    )


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Judge the rules on vehicles of known errors, on known roads and on roads that no regressor has seen."""
    figures = _simulated_figures(bench)
    tables = [_simulated_table(name, figures) for name in KINDS_OF_TRAFFIC]
    pictures: list[Picture] = [_simulated_picture(name, figures) for name in KINDS_OF_TRAFFIC]
    sizes = {"windows": _windows_count(bench), "batches": _batches_count(bench), "seed": bench.seed}
    for config, recipe in CONFIGS.items():
        known, random = on_known_roads(bench, grade, recipe), held_out(bench, grade, recipe)
        unseen = on_other_roads(bench, grade, recipe, data_set=PAPER_SET)
        for where, judged, meant in (("known", known, recommended(known)), ("unseen", unseen, recommended(random))):
            found = _driven(bench, grade, f"{where}, {config}", judged, meant)
            sizes[f"{where} runs"] = len(judged)
            for (rule, size), one in found.items():
                figures[f"{where}.{config}.{rule}.{size}.mean"] = one.mean_ratio
                figures[f"{where}.{config}.{rule}.{size}.worst_p95"] = one.worst.p95_ratio
                figures[f"{where}.{config}.{rule}.{size}.answered_frac"] = one.answered_frac
            tables += _driven_tables(f"{where} roads, {recipe.name} regressor", found)
            pictures.append(_driven_picture(f"{where} roads, {recipe.name} regressor", found))
        # The estimator is chosen beforehand, not the best of many on the very batches that judge them.
        figures[f"headline.{config}.interval10_worst_known_best"] = figures[f"known.{config}.{REFINED}.10.worst_p95"]
        if config == BEST:
            # What is published; that of the paper's configuration is given by the chapter on the published interval.
            figures["headline.best.interval50_worst_known"] = figures[f"known.{BEST}.{MEDIAN}.50.worst_p95"]
    return Result(figures=figures, sizes=sizes, tables=tuple(tables), pictures=tuple(pictures))


def _simulated_figures(bench: Workbench) -> dict[str, float]:
    """Return what vehicles of known errors come to; computed once for all grades, since sensors play no part."""

    def work() -> Arrays:
        figures: dict[str, float] = {}
        for done, (name, traffic) in enumerate(KINDS_OF_TRAFFIC.items()):
            bench.report(f"vehicles of known errors: {name}", done, len(KINDS_OF_TRAFFIC))
            found = simulated(traffic, windows_count=_windows_count(bench), seed=bench.seed)
            figures |= {f"simulated.{name}.{rule}.{size}": value for (rule, size), value in found.items()}
        for name, plain in (("widened", False), ("plain", True)):
            held = held_frac(plain, windows_count=_windows_count(bench), seed=bench.seed)
            figures[f"half_width.{name}.held_frac"] = held
        return {name: np.array(value) for name, value in figures.items()}

    return {name: float(value) for name, value in bench.remembered(f"pooling-simulated-{bench.seed}", work).items()}


def simulated(traffic: Traffic, *, windows_count: int, seed: int) -> dict[tuple[str, int], float]:
    """Return the mean magnitude of the relative error by rule and number of vehicles.

    Args:
        traffic: What is assumed of the vehicles.
        windows_count: Windows that are drawn; the same for every rule.
        seed: Of the windows.
    """
    found = {}
    for size in SIMULATED_SIZES_COUNT:
        seeds = _seeds(seed, size, windows_count)
        draw = partial(drawn_passages, count=size, mu_new=MU_NEW, traffic=traffic)
        for name, rule in RULES.items():
            errors = relative_errors(rule, draw, mu_new=MU_NEW, seeds=seeds)
            found[name, size] = float(np.mean(np.abs(errors)))
    return found


def held_frac(plain: bool, *, windows_count: int, seed: int) -> float:  # noqa: FBT001 - which of two
    """Return how often the half-width of fifty vehicles holds the truth when all share an error of 3 %.

    Args:
        plain: Whether the half-width knows nothing of such errors.
        windows_count: Windows that are drawn.
        seed: Of the windows.
    """
    policy = replace(POLICY, road_bias_ratio=0.0, shared_error_frac=0.0) if plain else POLICY
    held = []
    for number in _seeds(seed, 50, windows_count).tolist():
        passages = drawn_passages(
            np.random.default_rng(number), 50, mu_new=MU_NEW, traffic=KINDS_OF_TRAFFIC["all share an error of 3 %"]
        )
        placed = interval_of(passages, policy=policy)
        held.append(abs(placed.mu_new - MU_NEW) <= placed.half_width_mu)
    return float(np.mean(held))


def passages_of(judged: HeldOut) -> Passages:
    """Return what passages say, one for every run of their data set; none is taken for a bound. (runs,)"""
    return Passages(
        mu=judged.of_all_runs(np.maximum(judged.mu, LEAST_MU)),
        expected_error_ratio=judged.of_all_runs(judged.expected_error_ratio),
        at_least=np.zeros(len(judged.runs), dtype=np.bool_),
    )


def rules_on(judged: HeldOut, meant: Conformal) -> dict[str, Rule]:
    """Return the rules that are compared on driven data, each for the same rows of its table.

    Args:
        judged: The data, and what strangers made of it.
        meant: What is made of the errors to expect.
    """
    plain = passages_of(judged)
    return {
        FLOOR: published_rule(judged.runs.labels["label_mu"]),
        **{name: rule_on_rows(RULES[name], plain) for name in JUDGED},
        BOUNDED_MEDIAN: rule_on_rows(RULES[KAPLAN_MEIER], plain.with_bounds(meant)),
        BOUNDED: rule_on_rows(refined_or_nothing_mu, plain.with_bounds(meant)),
    }


def _driven(
    bench: Workbench, grade: SensorGrade, what: str, judged: HeldOut, meant: Conformal
) -> dict[tuple[str, int], Judged]:
    cells = cells_of(judged.runs.scenario, judged.runs.labels["base_friction_mu"], rows=judged.rows)
    rules = rules_on(judged, meant)
    found = {}
    for done, size in enumerate(DRIVEN_SIZES_COUNT):
        bench.report(f"batches, {what}, {grade}", done, len(DRIVEN_SIZES_COUNT))
        answers = {
            name: [
                answers_of_cell(cell, rule, size_count=size, batches_count=_batches_count(bench), seed=bench.seed)
                for cell in cells
            ]
            for name, rule in rules.items()
        }
        answers[MEDIAN_THERE] = [
            np.where(np.isfinite(careful), median, np.nan)
            for careful, median in zip(answers[BOUNDED], answers[MEDIAN], strict=True)
        ]
        for name, lines in answers.items():
            pairs = zip(cells, lines, strict=True)
            found[name, size] = judged_of(tuple(errors_of_answers(cell, mu, size_count=size) for cell, mu in pairs))
    return found


def _windows_count(bench: Workbench) -> int:
    return QUICK_WINDOWS_COUNT if bench.quick else WINDOWS_COUNT


def _batches_count(bench: Workbench) -> int:
    return QUICK_BATCHES_COUNT if bench.quick else BATCHES_COUNT


def _seeds(seed: int, size_count: int, windows_count: int) -> RowIndices:
    return np.random.default_rng([seed, size_count]).integers(2**62, size=windows_count).astype(np.intp)


def _simulated_lines(name: str, figures: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
    """Return the errors by number of vehicles, in per cent, of every rule."""
    sizes = SIMULATED_SIZES_COUNT
    return {rule: tuple(100.0 * figures[f"simulated.{name}.{rule}.{size}"] for size in sizes) for rule in RULES}


def _simulated_table(name: str, figures: Mapping[str, float]) -> Table:
    return Table(
        f"Mean error of the interval's middle by number of vehicles, in per cent: {name}",
        ("rule", *(str(size) for size in SIMULATED_SIZES_COUNT)),
        tuple((rule, *line) for rule, line in _simulated_lines(name, figures).items()),
        "Drawn: wear even in [0.8, 1], noise 2 to 8 % and known, 3 % outliers.",
    )


def _simulated_picture(name: str, figures: Mapping[str, float]) -> Lines:
    x = tuple(float(size) for size in SIMULATED_SIZES_COUNT)
    return Lines(
        f"Error against number of vehicles: {name}",
        Axis("vehicles", logarithmic=True),
        Axis("mean error, per cent", low=0.0),
        tuple(Line(rule, x, line) for rule, line in _simulated_lines(name, figures).items()),
    )


def _names(judged: Mapping[tuple[str, int], Judged]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(rule for rule, _ in judged))


def _driven_tables(where: str, judged: Mapping[tuple[str, int], Judged]) -> list[Table]:
    def table(title: str, value: str, note: str) -> Table:
        rows: list[tuple[TableCell, ...]] = []
        for rule in _names(judged):
            ones = [judged[rule, size] for size in DRIVEN_SIZES_COUNT]
            cells = [100.0 * (one.mean_ratio if value == "mean" else one.worst.p95_ratio) for one in ones]
            fifty = judged[rule, 50].worst
            answered = 100.0 * judged[rule, 50].answered_frac
            rows.append((rule, *cells, f"{fifty.road} at {fifty.base_friction_mu:.2f}", answered))
        sizes = (str(size) for size in DRIVEN_SIZES_COUNT)
        columns = ("rule", *sizes, "worst cell with 50", "answered with 50, per cent")
        return Table(title, columns, tuple(rows), note)

    return [
        table(f"Mean error by number of vehicles, in per cent: {where}", "mean", "Mean over batches, then over cells."),
        table(
            f"Error in the worst cell by number of vehicles, in per cent: {where}",
            "worst",
            "95th percentile over batches from one road at one base friction, the worst of all such cells.",
        ),
    ]


def _driven_picture(where: str, judged: Mapping[tuple[str, int], Judged]) -> Lines:
    x = tuple(float(size) for size in DRIVEN_SIZES_COUNT)
    return Lines(
        f"Error in the worst cell against number of vehicles: {where}",
        Axis("vehicles", logarithmic=True),
        Axis("95th percentile over batches, per cent", low=0.0),
        tuple(
            Line(
                rule,
                x,
                tuple(100.0 * judged[rule, size].worst.p95_ratio for size in DRIVEN_SIZES_COUNT),
                dashed=rule == FLOOR,
            )
            for rule in _names(judged)
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say what the refined interval wins, and where."""
    first = next(iter(results.values())).figures
    known_errors, shy = "known errors", "six in ten need little grip"

    def drawn(name: str, rule: str) -> str:
        return per_cent_words(first[f"simulated.{name}.{rule}.50"])

    def worst(where: str, config: str, rule: str, size: int) -> str:
        return by_grade(results, f"{where}.{config}.{rule}.{size}.worst_p95")

    def both(where: str, config: str, size: int) -> str:
        return f"{worst(where, config, MEDIAN, size)} by the median, {worst(where, config, REFINED, size)} refined"

    text = (
        f"With fifty vehicles whose errors are known the median is off by {drawn(known_errors, MEDIAN)} in the mean, "
        f"the refined interval by {drawn(known_errors, REFINED)}. If six in ten need little grip and only know a lower "
        f"bound, the plain median is off by {drawn(shy, MEDIAN)}, the Kaplan-Meier median by "
        f"{drawn(shy, KAPLAN_MEIER)}, the refined interval by {drawn(shy, REFINED)}. An error of 3 % that all share "
        "swamps such gains; the half-width that allows for it holds the truth in "
        f"{per_cent_words(first['half_width.widened.held_frac'])} of the windows, a plain one in "
        f"{per_cent_words(first['half_width.plain.held_frac'])}. Driven, by the best regressor, in the worst cell of "
        f"road and friction: ten vehicles on known roads {both('known', BEST, 10)}; fifty {both('known', BEST, 50)}, "
        f"with perfect estimates {worst('known', BEST, FLOOR, 50)}; fifty on the paper's roads when nothing was "
        f"learned of them {both('unseen', BEST, 50)}. {_where_named(results, f'unseen.{BEST}')} The paper's "
        f"configuration, fifty vehicles: known roads {both('known', PAPER, 50)}; unseen ones "
        f"{both('unseen', PAPER, 50)}."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


def _where_named(results: Mapping[SensorGrade, Result], place: str) -> str:
    """Return how far off the batches are for which a friction is named, in a sentence."""
    frac = f"{place}.{BOUNDED}.50.answered_frac"
    answered = {grade: result for grade, result in results.items() if result.figures[frac] > 0.0}
    if not answered:
        return "If doubtful estimates count as bounds, no batch has enough that name a friction."
    return (
        f"If doubtful estimates count as bounds, a friction is named in {by_grade(answered, frac)} of these batches; "
        f"the worst cell is then {by_grade(answered, f'{place}.{BOUNDED}.50.worst_p95')}."
    )


CHAPTER = Chapter(
    name="pooling",
    title="A better interval than the plain median",
    paper_says="The median of the last vehicles; with ten a barely tolerable worst error, with fifty about 10 %.",
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET, *LEARNED_SETS),
)
